"""The program of a study: several runs side by side, vmapped and sharded over devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec

from pecjax.agents.agent import AXIS, Metrics, TrainState, fleet_mesh
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.navigation import RoomsNavigation
from pecjax.envs.rooms.scene import Scene
from pecjax.runtime.devices import check_memory, choose_num_devices
from pecjax.training.build import make_agent
from pecjax.training.evaluation import EvalResult, make_flyer, stratified_config_ids
from pecjax.training.presets import RunSettings


class Program(NamedTuple):
    """K runs; every leaf of every argument and result has a leading axis K.

    Attributes:
        init: (seeds, numbers of the sampler by name) -> states.
        iterate: (states) -> (states, metrics).
        evaluate: (learners) -> flights, without their paths.
        steps_per_iteration: of each run.
    """

    init: Callable[[np.ndarray, dict[str, np.ndarray]], TrainState]
    iterate: Callable[[TrainState], tuple[TrainState, Metrics]]
    evaluate: Callable[[Any], EvalResult]
    steps_per_iteration: int


def make_program(settings: RunSettings, scene: Scene, table: Configurations, runs: int) -> Program:
    """Makes the program that trains so many runs, which differ in seed and in numbers of their sampler.

    Every device has whole runs to itself, so devices never wait for one another within an
    iteration, and a run is what it would be on one device alone.

    Raises:
        InputError: settings that do not fit one another, or replays that memory cannot hold.
    """
    env = RoomsNavigation(scene, table)
    devices = choose_num_devices(None, runs)
    mesh = fleet_mesh(devices)

    agent = make_agent(settings, env, table, settings.sampler.make(table.size))
    check_memory(agent.replay_bytes * runs, devices)
    fly = make_flyer(env, table, agent, greedy=settings.greedy, seed=settings.evaluation_seed)
    config_id = stratified_config_ids(table.size, settings.evaluation_episodes, settings.evaluation_seed)

    def init(seed: jax.Array, numbers: dict[str, jax.Array]) -> TrainState:
        return agent.init(jax.random.key(seed), numbers)

    def evaluate(learner: Any) -> EvalResult:
        return fly(learner, jnp.asarray(config_id), jnp.arange(config_id.size))._replace(paths=None)

    def spread(one: Callable, **options: Any) -> Callable:
        spec = PartitionSpec(AXIS)
        many = jax.shard_map(jax.vmap(one), mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
        return jax.jit(many, **options)

    # The numbers are in the sampler's state, so one `iterate` serves all.
    iterate = spread(agent.iterate, donate_argnums=0)
    return Program(spread(init), iterate, spread(evaluate), agent.steps_per_iteration)
