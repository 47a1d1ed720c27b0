"""Recordings: what is shown of some flights, made of the arrays of an evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.rooms.config import Configurations, leads_to_waypoint
from pecjax.envs.rooms.map_file import ENDLESS, Map, map_of
from pecjax.envs.rooms.task import RoomsTask
from pecjax.envs.task import Task, World, take_configs
from pecjax.errors import InputError
from pecjax.training.kinds import run_label
from pecjax.training.run_arrays import endings, last_recording
from pecjax.training.run_directory import RunDirectory
from pecjax.viewing.history import History, read_history

Camera = Callable[[Configurations, np.ndarray], np.ndarray]

MARGIN = 0.5  # m, by which walls without an end stand out
BATCH = 256  # images that are computed at once


class Flight(NamedTuple):
    """One flight of L actions.

    Attributes:
        config_id: its configuration's row.
        map_id: the map that it is in.
        ending: one of `ENDINGS`.
        goal: (2,) m.
        waypoint: (2,) m, None where there is none to pass.
        poses: (L + 1, 7) position m and attitude quaternion w-x-y-z.
        commands: (L, 2) speed m/s and yaw rate rad/s that were asked for.
        depth: (L + 1, H, W) m, what the camera shows; its noise is drawn anew.
    """

    config_id: int
    map_id: int
    ending: str
    goal: np.ndarray
    waypoint: np.ndarray | None
    poses: np.ndarray
    commands: np.ndarray
    depth: np.ndarray


class Recording(NamedTuple):
    """Some flights with all that is needed to show them.

    Attributes:
        title: what flew where.
        task: rules, drone and camera.
        maps: those that are flown in, by number.
        flights: the flights.
    """

    title: str
    task: RoomsTask
    maps: dict[int, Map]
    flights: tuple[Flight, ...]


def read_recording(folder: Path, most: int) -> tuple[Recording, History]:
    """The flights of a run's last evaluation, and how its training drew.

    Args:
        most: how many flights, spread evenly over those that were recorded.

    Raises:
        InputError: the folder holds no finished run, or one of another task.
    """
    run = RunDirectory(folder)
    settings, task_settings = run.settings(), run.task()
    task, world = task_settings.make()
    flown = world._replace(table=task_settings.eval_set(world).table)
    with last_recording(run) as arrays:
        recording = make_recording(run_label(settings), task, flown, arrays, most)
    return recording, read_history(run, world.table)


def make_recording(
    title: str, task: Task, world: World, arrays: Mapping[str, np.ndarray], most: int
) -> Recording:
    """Puts a recording together.

    Args:
        world: with the configurations that were flown.
        arrays: of the episodes, as `rows.episode_arrays` and `rows.recording_arrays` have them.
        most: how many flights, spread evenly over those that were recorded.

    Raises:
        InputError: the task is not that of the rooms.
        KeyError, IndexError, ValueError, TypeError: the arrays are not those of this task.
    """
    if not isinstance(task, RoomsTask):
        raise InputError("only flights through rooms can be watched; the run is of another task")
    recorded = np.asarray(arrays["recorded"])
    chosen = np.linspace(0, len(recorded) - 1, min(most, len(recorded))).astype(int)
    ending, camera = endings(arrays), _camera(task, world)
    command = task.command(jnp.arange(task.action_space.num_actions))
    commands = np.stack([command.speed, command.yaw_rate], axis=1)
    flights = tuple(_flight(world, camera, commands, ending, arrays, int(place)) for place in chosen)
    if not flights:
        raise ValueError("no flights")
    numbers = sorted({flight.map_id for flight in flights})
    maps = {number: map_of(world.params.bank, number) for number in numbers}
    return Recording(title, task, maps, flights)


def _flight(
    world: World,
    camera: Camera,
    commands: np.ndarray,
    ending: np.ndarray,
    arrays: Mapping[str, np.ndarray],
    place: int,
) -> Flight:
    episode = int(arrays["recorded"][place])
    length = int(arrays["length"][episode])
    poses, actions = (arrays[name][place] for name in ("poses", "actions"))
    if length < 1 or len(poses) <= length or len(actions) < length or poses.shape[1:] != (7,):
        raise ValueError(f"episode {episode} has no {length} poses and actions")
    poses = poses[: length + 1]
    config_id = int(arrays["config_id"][episode])
    config = jax.tree.map(np.asarray, take_configs(world.table, config_id))
    return Flight(
        config_id,
        int(config.map_id),
        str(ending[episode]),
        config.goal,
        config.waypoint if leads_to_waypoint(config) else None,
        poses,
        commands[actions[:length]],
        camera(config, poses),
    )


def _camera(task: RoomsTask, world: World) -> Camera:
    """(configuration, poses (P, 7)) -> depth images (P, H, W) m, compiled once for any P."""

    @jax.jit
    def look(config: Configurations, poses: jax.Array, params: Any) -> jax.Array:
        def one(key: jax.Array, pose: jax.Array) -> jax.Array:
            state = task.place(config, jnp.float32(0))._replace(qpos=pose)
            return task.sense(key, state, params)["depth"]

        return jax.vmap(one)(jax.random.split(jax.random.key(0), BATCH), poses)

    def images(config: Configurations, poses: np.ndarray) -> np.ndarray:
        batches = np.resize(poses, (-(-len(poses) // BATCH), BATCH, 7)).astype(np.float32)
        parts = [np.asarray(look(config, batch, world.params)) for batch in batches]
        return np.concatenate(parts)[: len(poses)]

    return images


def drawn_walls(about: Map) -> tuple[np.ndarray, np.ndarray]:
    """Corners (D, 3) m of the walls to be drawn in three dimensions.

    Floors and ceilings, which would hide all the rest, are left out; what has no end is cut off near the
    others.
    """
    low, high = about.bounds
    heights = np.stack([about.lower, about.upper])[..., 2]
    heights = heights[np.abs(heights) < ENDLESS]
    least, most = [*(low - MARGIN), heights.min() - MARGIN], [*(high + MARGIN), heights.max() + MARGIN]
    shown = ~about.covers
    return np.clip(about.lower[shown], least, most), np.clip(about.upper[shown], least, most)
