"""Objectives: where the drone must go next in its episode, and when it has done what was asked."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pecjax.envs.rooms.config import HOLD, OBJECTIVES, VIA, Configurations


def first_progress(config: Configurations) -> jax.Array | None:
    """() int32, how far an episode has come at its start; None in a table without objectives."""
    return None if config.objective is None else jnp.zeros((), jnp.int32)


def target(config: Configurations, progress: jax.Array | None) -> jax.Array:
    """(2,) m, where to go now: the goal, but for a waypoint that has not been passed yet."""
    if config.waypoint is None or progress is None:
        return config.goal
    return jnp.where((config.objective == VIA) & (progress == 0), config.waypoint, config.goal)


def advance(
    config: Configurations, progress: jax.Array | None, near: jax.Array, hold_steps: int
) -> tuple[jax.Array | None, jax.Array]:
    """One control step further.

    Args:
        progress: () int32, 1 once the waypoint was passed; of a goal to be held, the steps in a row that
            ended near it.
        near: () bool, whether this step ended within the goal radius of `target`.
        hold_steps: control steps for which a goal is to be held.

    Returns:
        the new progress, and () bool, whether the objective is met.
    """
    if progress is None:
        return None, near
    hold, via = config.objective == HOLD, config.objective == VIA
    after = jnp.where(hold, (progress + 1) * near, progress | (via & near)).astype(jnp.int32)
    # The first step near a goal is when the time begins.
    reached = near & (~via | (progress > 0))
    return after, (hold & (after > hold_steps)) | (~hold & reached)


def is_holding(config: Configurations, progress: jax.Array) -> jax.Array:
    """() bool, whether the drone is where it must stay, so that to stand still is no idling."""
    return (config.objective == HOLD) & (progress > 0)


def one_hot(config: Configurations) -> jax.Array:
    """(3,) 1 for the objective, 0 for the others."""
    return jax.nn.one_hot(config.objective, len(OBJECTIVES))
