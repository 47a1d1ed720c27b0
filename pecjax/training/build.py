"""Assembly: world, curriculum and learner put together as the settings say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
from jax.sharding import Mesh, NamedSharding

from pecjax.agents import apex, ppo
from pecjax.agents.agent import AXIS, Agent, TrainState, fleet_mesh, placement, shard
from pecjax.curriculum import Sampler
from pecjax.envs.rooms.config import Configurations, load_coordinates
from pecjax.envs.rooms.navigation import RoomsNavigation
from pecjax.envs.rooms.scene import Scene, default_scene_path, load_scene
from pecjax.envs.rooms.validity import check_coordinates
from pecjax.runtime.devices import check_memory
from pecjax.training import evaluation
from pecjax.training.limits import image_bytes
from pecjax.training.presets import RunSettings, check_settings


class Run(NamedTuple):
    """What a run is built from."""

    env: RoomsNavigation
    table: Configurations
    sampler: Sampler
    agent: Agent
    mesh: Mesh


def load_world(settings: RunSettings) -> tuple[Path, Scene, Configurations]:
    """The map's file, the map and the coordinates, checked against one another and the task.

    `pecjax check`, trainings and studies all read their world here, and so agree about it.

    Raises:
        InputError: a file that is not there or is wrong, a timestep that does not fit, or pairs that
            cannot be flown.
    """
    scene_path = Path(settings.scene) if settings.scene is not None else default_scene_path()
    table = load_coordinates(settings.coordinates)
    scene = load_scene(scene_path, settings.resolution)
    flight_height = RoomsNavigation(scene, table).settings.flight_height
    check_coordinates(scene, table, flight_height=flight_height, source=settings.coordinates)
    return scene_path, scene, table


def make_agent(
    settings: RunSettings,
    env: RoomsNavigation,
    table: Configurations,
    sampler: Sampler,
    axis_name: str | None = None,
) -> Agent:
    """The learner that the settings name.

    Raises:
        InputError: settings that do not fit one another.
    """
    if settings.algorithm == "apex":
        return apex.make(env, table, sampler, settings.apex, axis_name)
    return ppo.make(env, table, sampler, settings.ppo, axis_name)


def build(
    settings: RunSettings, scene: Scene, table: Configurations, num_devices: int, *, trains: bool = True
) -> Run:
    """Puts world, curriculum and learner together, spread over devices.

    Args:
        trains: makes sure that memory can hold replay and images; a policy that is only flown needs neither.

    Raises:
        InputError: settings that are absurd or do not fit one another, or images or a replay that
            memory cannot hold.
    """
    check_settings(settings)
    env = RoomsNavigation(scene, table)
    sampler = settings.sampler.make(table.size)
    mesh = fleet_mesh(num_devices)
    agent = make_agent(settings, env, table, sampler, AXIS)
    if trains:
        check_memory(agent.replay_bytes, num_devices)
        images = image_bytes(settings, scene.camera)
        check_memory(images, num_devices, "the depth images of an iteration take")
    return Run(env, table, sampler, shard(agent, mesh), mesh)


def abstract_state(run: Run) -> TrainState:
    """Shapes and placement of a TrainState's arrays, without making any of them."""
    state = jax.eval_shape(run.agent.init, jax.random.key(0))

    def placed(part: Any, place: NamedSharding) -> Any:
        return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=place), part)

    return TrainState(*map(placed, state, placement(run.mesh)))


def compile_evaluator(
    run: Run, settings: RunSettings, learner: Any
) -> Callable[[Any], evaluation.EvalResult]:
    """The run's evaluation as a compiled program, learner -> flights.

    Raises:
        InputError: more episodes than memory holds the images of.
    """
    images = image_bytes(settings, run.env.scene.camera, settings.evaluation_episodes)
    check_memory(images, run.mesh.devices.size, "the depth images of an evaluation take")
    return evaluation.make_evaluator(
        run.env,
        run.table,
        run.agent,
        run.mesh,
        episodes=settings.evaluation_episodes,
        greedy=settings.greedy,
        seed=settings.evaluation_seed,
    )(learner)
