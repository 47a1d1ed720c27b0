"""Evaluation: a policy run over a fixed, even draw of the configurations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pecjax.agents import AXIS, Agent
from pecjax.agents.episodes import reset_where, start_episodes, step_episodes
from pecjax.agents.sharding import env_keys
from pecjax.envs.task import Task, World, num_configs, take_configs
from pecjax.runtime.devices import compiler_options


class EvalResult(NamedTuple):
    """E finished episodes.

    Attributes:
        config_id: (E,) int.
        success: (E,) bool, whether it ended in success.
        returns: (E,) sum of rewards.
        lengths: (E,) int, actions taken.
        metrics: (E,) each, the task's metrics over the episode.
        poses: (E, T + 1, 7), see `Task.pose`; past its end where it ended. None of a task without poses.
        actions: (E, T, …), zeros past its end; None of a task without poses.
    """

    config_id: Any
    success: Any
    returns: Any
    lengths: Any
    metrics: dict[str, Any]
    poses: Any = None
    actions: Any = None

    def goal_ratios(self) -> np.ndarray:
        """Share of successes (N,) of each configuration up to the last that was run."""
        return success_by_config(self.config_id, self.success, int(self.config_id.max()) + 1)


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

    Its `compile` takes a learner (arrays or their shapes) and a world, and returns
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


def run_episodes(
    task: Task,
    world: World,
    act: Callable[..., Any],
    keys: jax.Array,
    config_id: jax.Array,
    first_memory: Any = None,
) -> EvalResult:
    """Runs one episode per key (E,) and configuration (E,), all side by side, until the last has ended.

    Args:
        act, first_memory: see `Agent`.
    """

    def act_once(obs: Any, key: jax.Array, memory: Any) -> tuple[jax.Array, Any]:
        return (act(obs, key), None) if memory is None else act(obs, key, memory)

    limit, number = task.max_steps, config_id.shape[0]
    shared = (0, 0, None)
    reset, observe = jax.vmap(task.reset, shared), jax.vmap(task.observe, shared)
    start = reset(keys, take_configs(world.table, config_id), world.params)
    first = jax.vmap(jax.random.fold_in, (0, None))(keys, limit)  # steps fold in numbers below it
    memory = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (number, *leaf.shape)), first_memory)
    obs = jax.eval_shape(observe, first, start, world.params)
    actions, _ = jax.eval_shape(jax.vmap(act_once), obs, keys, memory)
    recording = _start_recording(task, start, actions)
    running = start_episodes(config_id, task.metrics)
    nothing = {name: jnp.zeros(number) for name in task.metrics}
    none = jnp.zeros(number, bool)

    def are_running(carry: tuple) -> jax.Array:
        time, _, _, _, done, *_ = carry
        return (time < limit) & ~jnp.all(done)

    def step(carry: tuple) -> tuple:
        time, state, key_obs, running, done, success, metrics, memory, recording = carry
        # Here alone, and not before the loop, too: images are most of the program.
        obs = observe(key_obs, state, world.params)
        now = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, time)
        # The action's draws are those of `now`; the task's are of keys of their own.
        of_task = jax.vmap(lambda key: jax.random.split(key, 2), out_axes=1)(now)
        actions, memory = jax.vmap(act_once)(obs, now, memory)
        after = jax.vmap(task.step, (0, 0, 0, None))(of_task[1], state, actions, world.params)
        further, episodes = step_episodes(running, after, task.metrics)
        state, running, success, metrics = reset_where(
            done,
            (state, running, success, metrics),
            (after.state, further, after.success, episodes.metrics),
        )
        if recording is not None:
            poses, taken = recording
            mask = done.reshape(-1, *[1] * (actions.ndim - 1))
            recording = (
                poses.at[time + 1].set(jax.vmap(task.pose)(state)),
                taken.at[time].set(jnp.where(mask, 0, actions)),
            )
        done = done | episodes.outcomes.done
        return time + 1, state, of_task[0], running, done, success, metrics, memory, recording

    time, state, _, running, _, success, metrics, _, recording = jax.lax.while_loop(
        are_running, step, (jnp.int32(0), start, first, running, none, none, nothing, memory, recording)
    )
    poses = taken = None
    if recording is not None:
        beyond = jnp.arange(limit + 1)[:, None, None] > time
        poses = jnp.where(beyond, jax.vmap(task.pose)(state), recording[0]).swapaxes(0, 1)
        taken = recording[1].swapaxes(0, 1)
    return EvalResult(config_id, success, running.episode_return, running.length, metrics, poses, taken)


def _start_recording(task: Task, start: Any, actions: Any) -> tuple[jax.Array, jax.Array] | None:
    """Poses (T + 1, E, 7), the first of them filled in, and actions (T, E, …), none taken yet.

    Args:
        actions: (E, …), their shape and type.
    """
    pose = jax.vmap(task.pose)(start)
    if pose is None:
        return None
    poses = jnp.zeros((task.max_steps + 1, *pose.shape), pose.dtype).at[0].set(pose)
    return poses, jnp.zeros((task.max_steps, *actions.shape), actions.dtype)


def success_by_config(config_id: np.ndarray, success: np.ndarray, num_configs: int) -> np.ndarray:
    """Share of successes (N,) of each configuration, NaN where it had no episode (E,)."""
    episodes = np.bincount(config_id, minlength=num_configs)
    reached = np.bincount(config_id, weights=success, minlength=num_configs)
    return np.where(episodes > 0, reached / np.maximum(episodes, 1), np.nan)
