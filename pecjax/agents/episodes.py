"""Episodes: sums over running episodes, and what is reported and counted when they end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, by_config, count_outcomes
from pecjax.envs.task import Reduction, Transition

_START = {"sum": 0.0, "mean": 0.0, "min": jnp.inf, "max": -jnp.inf}


class Running(NamedTuple):
    """The running episodes of B environments.

    Attributes:
        config_id: (B,) int32, the configuration each was reset with.
        episode_return: (B,), rewards so far.
        length: (B,) int32, actions so far.
        metrics: (B,) each, the task's metrics so far, without those of which only the last counts.
        score: (B,), the sum of the learner's scores of its steps before this batch.
    """

    config_id: jax.Array
    episode_return: jax.Array
    length: jax.Array
    metrics: dict[str, jax.Array]
    score: jax.Array


class Episodes(NamedTuple):
    """The endings within a rollout, arrays (T, B) that count where `outcomes.done` is true.

    Attributes:
        outcomes: what the sampler learns from.
        metrics: the task's, over the episode.
    """

    outcomes: Outcomes
    metrics: dict[str, jax.Array]


def start_episodes(config_id: jax.Array, metrics: Mapping[str, Reduction]) -> Running:
    """Episodes that have just been reset with these configurations (B,)."""
    nothing = jnp.zeros(config_id.shape)
    running = {name: nothing + _START[how] for name, how in metrics.items() if how != "last"}
    return Running(config_id, nothing, nothing.astype(jnp.int32), running, nothing)


def step_episodes(
    running: Running, transition: Transition, metrics: Mapping[str, Reduction]
) -> tuple[Running, Episodes]:
    """The episodes with one step more, and what they report should they end in it."""
    length = running.length + 1
    kept, reported = {}, {}
    for name, how in metrics.items():
        new = jnp.asarray(transition.metrics[name], jnp.float32)
        if how in ("sum", "mean"):
            new = running.metrics[name] + new
        elif how != "last":
            new = (jnp.minimum if how == "min" else jnp.maximum)(running.metrics[name], new)
        if how != "last":
            kept[name] = new
        reported[name] = new / length if how == "mean" else new
    episode_return = running.episode_return + transition.reward
    done = transition.terminated | transition.truncated
    outcomes = Outcomes(running.config_id, done, done & ~transition.success, length, episode_return)
    running = Running(running.config_id, episode_return, length, kept, running.score)
    return running, Episodes(outcomes, reported)


def sum_over_episodes(before: jax.Array, scores: jax.Array, done: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sums of what a learner gives each step, over the episode that the step is of.

    Args:
        before: (B,), of the running episodes' steps before this batch.
        scores, done: (T, B), of its steps, and whether they end an episode.

    Returns:
        (T, B), up to each step, itself with it; (B,), of the episodes that run on.
    """

    def step(total: jax.Array, row: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        score, ends = row
        total = total + score
        return jnp.where(ends, 0.0, total), total

    left, sums = jax.lax.scan(step, before, (scores, done.astype(bool)))
    return sums, left


def no_counts(num_configs: int) -> jax.Array:
    """Of configurations that nobody has tried: (3, N) int32, trials, failures and steps."""
    return jnp.zeros((3, num_configs), jnp.int32)


def add_counts(counts: jax.Array, outcomes: Outcomes, axis_name: str | None) -> jax.Array:
    """The counts (3, N) with the trials, failures and steps of episodes that have ended."""
    number = counts.shape[1]
    steps = by_config(outcomes, "length", number, axis_name=axis_name).astype(jnp.int32)
    return count_on(counts, jnp.concatenate([count_outcomes(outcomes, number, axis_name), steps[None]]))


def count_on(count: jax.Array, number: jax.Array | int) -> jax.Array:
    """The counts (int32) and so many more, or their type's greatest number where that is less."""
    return jnp.minimum(count, jnp.iinfo(count.dtype).max - number) + number


def reset_where(done: jax.Array, fresh: Any, old: Any) -> Any:
    """Leaves (B, …) of `fresh` where an episode is done, else those of `old`."""

    def choose(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(done.reshape(-1, *[1] * (old.ndim - 1)), new, old)

    return jax.tree.map(choose, fresh, old)
