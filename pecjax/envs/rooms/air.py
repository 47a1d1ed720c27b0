"""Moving air: the drag of an airframe in it, and gusts."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp

from pecjax.envs.rooms.rotations import dot


def drag_force(
    drag: tuple[float, float, float], air: Any, rotation: Any, velocity: Any
) -> tuple[jax.Array, ...]:
    """Force in N in the world, scalar by scalar, of air that moves past the drone.

    -c |u| u along each axis of the drone, where u is its velocity relative to the air, as in
    hector_quadrotor (Meyer et al. 2012, `quadrotor_aerodynamics`), without the drag of rotation.

    Args:
        drag: c along the drone's own x, y and z, N s²/m².
        air, velocity: (3,) m/s of the air and of the drone, in the world.
        rotation: (3, 3), columns are the drone's axes in the world. These three may be tuples of scalars.
    """
    relative = tuple(v - a for v, a in zip(velocity, air, strict=True))
    speed = jnp.sqrt(dot(relative, relative))
    along = [
        c * speed * dot(axis, relative) for c, axis in zip(drag, zip(*rotation, strict=True), strict=True)
    ]
    return tuple(-dot(along, row) for row in rotation)


def first_gust(key: jax.Array, deviation: jax.Array) -> jax.Array:
    """A gust (3,) m/s as it is when nothing is known of the time before.

    Args:
        deviation: () m/s, the standard deviation of each component.
    """
    return deviation * jax.random.normal(key, (3,))


def next_gust(
    key: jax.Array, gust: jax.Array, deviation: jax.Array, period: float, correlation_time: float
) -> jax.Array:
    """The gust (3,) m/s after `period` s: an Ornstein-Uhlenbeck process, exact for any period.

    Args:
        deviation: () m/s, of each component at any time.
        correlation_time: s, after which the correlation has fallen to 1/e.
    """
    kept = math.exp(-period / correlation_time)
    return kept * gust + math.sqrt(1 - kept**2) * first_gust(key, deviation)
