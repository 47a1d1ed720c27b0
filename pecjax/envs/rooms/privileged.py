"""Privileged: what a critic may know of the drone that the drone does not see."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pecjax.envs.rooms.rotations import heading
from pecjax.envs.rooms.sensing import DISTANCE_SCALE
from pecjax.envs.spaces import Box

SPEED_SCALE = 2.0  # m/s, the highest speed that is asked for


def space(with_path: bool) -> dict[str, Box]:
    """Of `drone_numbers`, and of `path_fields.path_from` where critics are told of paths."""
    return {"drone": Box((11,))} | ({"path": Box((3,))} if with_path else {})


def drone_numbers(
    qpos: jax.Array, qvel: jax.Array, height: float, lateness: jax.Array, idleness: jax.Array
) -> jax.Array:
    """Numbers near the unit range, (11,).

    They are place, heading, speeds along it, across it and up, yaw rate, height error, and how near the
    episode is to its limits.

    Args:
        qpos, qvel: (7,) and (6,), the free joint's state.
        height: m, that is to be held.
        lateness: () what share of its steps the episode has taken.
        idleness: () the actions in a row without speed, over how many go unpunished.
    """
    direction = heading(qpos[3:])
    cosine, sine = jnp.cos(direction), jnp.sin(direction)
    forward, sideward = cosine * qvel[0] + sine * qvel[1], cosine * qvel[1] - sine * qvel[0]
    return jnp.stack([
        qpos[0] / DISTANCE_SCALE,
        qpos[1] / DISTANCE_SCALE,
        cosine,
        sine,
        forward / SPEED_SCALE,
        sideward / SPEED_SCALE,
        qvel[2],
        qvel[5],
        qpos[2] - height,
        lateness,
        jnp.minimum(idleness, 2.0),
    ])  # fmt: skip
