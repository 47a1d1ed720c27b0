"""Episodes of one policy, run side by side until the last of them has ended."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.agents.episodes import Running, reset_where, start_episodes, step_episodes
from pecjax.envs.task import Task, World, take_configs

SIDE_BY_SIDE = 256  # episodes of a device that take steps at a time
STRETCH = 16  # steps they take, until others take theirs


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


class _Flights(NamedTuple):
    """E episodes on their way, each as it was left."""

    state: Any
    key_obs: jax.Array
    running: Running
    done: jax.Array
    success: jax.Array
    metrics: dict[str, jax.Array]
    memory: Any


def run_episodes(
    task: Task,
    world: World,
    act: Callable[..., Any],
    keys: jax.Array,
    config_id: jax.Array,
    first_memory: Any = None,
) -> EvalResult:
    """Runs one episode per key (E,) and configuration (E,), until the last has ended.

    A few take a few steps side by side, always those that have taken the fewest, so that one long episode
    does not keep all others waiting.

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
    running = start_episodes(config_id, task.metrics)
    nothing = {name: jnp.zeros(number) for name in task.metrics}
    none = jnp.zeros(number, bool)

    def have_ended(flights: _Flights) -> jax.Array:
        return flights.done | (flights.running.length >= limit)

    def step(keys: jax.Array, which: jax.Array, flights: _Flights, recording: Any) -> tuple[_Flights, Any]:
        ended, time = have_ended(flights), flights.running.length
        # Here alone, and not before the loop, too: images are most of the program.
        obs = observe(flights.key_obs, flights.state, world.params)
        now = jax.vmap(jax.random.fold_in)(keys, time)
        of_task = jax.vmap(lambda key: jax.random.split(key, 2), out_axes=1)(now)
        # Numbers that no key above is folded with: the policy's draws share none with the task's.
        of_act = jax.vmap(jax.random.fold_in, (0, None))(now, limit + 1)
        actions, memory = jax.vmap(act_once)(obs, of_act, flights.memory)
        after = jax.vmap(task.step, (0, 0, 0, None))(of_task[1], flights.state, actions, world.params)
        further, episodes = step_episodes(flights.running, after, task.metrics)
        state, running, success, metrics = reset_where(
            ended,
            (flights.state, flights.running, flights.success, flights.metrics),
            (after.state, further, after.success, episodes.metrics),
        )
        if recording is not None:
            poses, taken = recording
            mask = ended.reshape(-1, *[1] * (actions.ndim - 1))
            recording = (  # what is beyond an end is written over, or out of bounds
                poses.at[which, time + 1].set(jax.vmap(task.pose)(state)),
                taken.at[which, time].set(jnp.where(mask, 0, actions)),
            )
        done = flights.done | episodes.outcomes.done
        return _Flights(state, of_task[0], running, done, success, metrics, memory), recording

    def advance(carry: tuple[_Flights, Any]) -> tuple[_Flights, Any]:
        flights, recording = carry
        taken = jnp.where(have_ended(flights), limit, flights.running.length)
        which = jnp.argsort(taken)[:SIDE_BY_SIDE]
        some = jax.tree.map(lambda leaf: leaf[which], flights)
        some, recording = jax.lax.fori_loop(
            0, STRETCH, lambda _, carry: step(keys[which], which, *carry), (some, recording)
        )
        return jax.tree.map(lambda leaf, part: leaf.at[which].set(part), flights, some), recording

    flights, recording = jax.lax.while_loop(
        lambda carry: ~jnp.all(have_ended(carry[0])),
        advance,
        (
            _Flights(start, first, running, none, none, nothing, memory),
            _start_recording(task, start, actions),
        ),
    )
    running = flights.running
    poses, taken = (None, None) if recording is None else recording
    if poses is not None:
        times = jnp.arange(limit + 1)[:, None]
        poses = jax.vmap(lambda length, state, pose: jnp.where(times > length, task.pose(state), pose))(
            running.length, flights.state, poses
        )
    return EvalResult(
        config_id, flights.success, running.episode_return, running.length, flights.metrics, poses, taken
    )


def _start_recording(task: Task, start: Any, actions: Any) -> tuple[jax.Array, jax.Array] | None:
    """Poses (E, T + 1, 7), the first of them filled in, and actions (E, T, …), none taken yet.

    Args:
        actions: (E, …), their shape and type.
    """
    pose = jax.vmap(task.pose)(start)
    if pose is None:
        return None
    number, *shape = actions.shape
    poses = jnp.zeros((number, task.max_steps + 1, pose.shape[1]), pose.dtype).at[:, 0].set(pose)
    return poses, jnp.zeros((number, task.max_steps, *shape), actions.dtype)


def in_order(config_id: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The episodes (E,) by configuration, and how many of its configuration come before each of them."""
    order = np.argsort(config_id, kind="stable")
    ids = config_id[order]
    return order, np.arange(len(ids)) - np.searchsorted(ids, ids)


def success_by_config(config_id: np.ndarray, success: np.ndarray, num_configs: int) -> np.ndarray:
    """Share of successes (N,) of each configuration, NaN where it had no episode (E,)."""
    episodes = np.bincount(config_id, minlength=num_configs)
    reached = np.bincount(config_id, weights=success, minlength=num_configs)
    return np.where(episodes > 0, reached / np.maximum(episodes, 1), np.nan)
