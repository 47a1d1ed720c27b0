"""Evaluation: a policy run over a fixed, even draw of the configurations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pecjax.agents import AXIS, Agent
from pecjax.agents.sharding import env_keys
from pecjax.envs.task import Task, World, num_configs
from pecjax.runtime.devices import compiler_options
from pecjax.training.run_episodes import EvalResult, run_episodes


def stratified_config_ids(num_configs: int, episodes: int, seed: int) -> np.ndarray:
    """E configuration numbers, every configuration as often as any other.

    What remains when N does not divide E goes to different configurations, drawn at random.
    """
    rest = np.random.default_rng(seed).permutation(num_configs)[: episodes % num_configs]
    return np.concatenate([np.tile(np.arange(num_configs), episodes // num_configs), rest]).astype(np.int32)


def make_episode_runner(
    task: Task, agent: Agent, *, greedy: bool, seed: int
) -> Callable[[Any, World, jax.Array, jax.Array], EvalResult]:
    """Sets the conditions under which policies can be compared.

    The runner takes a learner, a world and, for each of E episodes, configuration and number, and returns
    `EvalResult`; it can be jitted, vmapped over learners and sharded over episodes.

    Args:
        greedy: takes the most likely action at every step; else draws, as training does.
        seed: of resets and drawn actions: two policies with one seed meet the same episodes.
    """

    def run(learner: Any, world: World, config_id: jax.Array, episode: jax.Array) -> EvalResult:
        keys = env_keys(jax.random.key(seed), episode)
        return run_episodes(task, world, agent.policy(learner, greedy), keys, config_id, agent.first_memory)

    return run


def make_evaluator(
    task: Task,
    agent: Agent,
    mesh: Mesh,
    *,
    episodes: int,
    greedy: bool,
    seed: int,
) -> Callable[[Any, World], Callable[[Any, World], EvalResult]]:
    """Sets E episodes, an even draw, shared by the mesh's devices.

    What it returns takes a learner (arrays or their shapes) and a world, and compiles
    evaluate(learner, world) -> `EvalResult` of numpy arrays; another world of the same shapes compiles
    nothing.

    Args:
        greedy, seed: of `make_episode_runner`.
    """
    devices = mesh.devices.size
    spread = PartitionSpec(AXIS)
    program = jax.jit(
        jax.shard_map(
            make_episode_runner(task, agent, greedy=greedy, seed=seed),
            mesh=mesh,
            in_specs=(PartitionSpec(), PartitionSpec(), spread, spread),
            out_specs=spread,
            check_vma=False,
        ),
        out_shardings=NamedSharding(mesh, PartitionSpec()),  # each process has all of them
        compiler_options=compiler_options(),
    )

    def compile_for(learner: Any, world: World) -> Callable[[Any, World], EvalResult]:
        config_id = stratified_config_ids(num_configs(world.table), episodes, seed)
        padded = np.resize(config_id, -(-episodes // devices) * devices)
        numbers = np.arange(padded.size, dtype=np.int32)
        compiled = program.lower(learner, world, padded, numbers).compile()

        def evaluate(learner: Any, world: World) -> EvalResult:
            result = compiled(learner, world, padded, numbers)
            return jax.tree.map(lambda leaf: np.asarray(leaf)[:episodes], result)

        return evaluate

    return compile_for
