"""Clearance: how far a point is from the nearest wall."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pecjax.envs.rooms.maps import FEW_WALLS, Walls
from pecjax.envs.rooms.rotations import dot


def wall_distance(walls: Walls, points: jax.Array) -> jax.Array:
    """Distance (…,) m from points (…, 3) m to the nearest wall, 0 inside one.

    A sphere of radius r around a point touches a wall where this is at most r.
    Oracle: C MuJoCo's sphere-box contacts.
    """
    return jnp.sqrt(squared_distance(walls, tuple(points[..., axis] for axis in range(3))))


def squared_distance(walls: Walls, places: tuple[jax.Array, ...]) -> jax.Array:
    """The square of `wall_distance`, of points as three coordinates (…,) m each."""

    def nearer(best: jax.Array, wall: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        lower, upper = wall
        beyond = [
            jnp.maximum(jnp.maximum(lower[axis] - place, place - upper[axis]), 0)
            for axis, place in enumerate(places)
        ]
        return jnp.minimum(best, dot(beyond, beyond)), None

    dtype = places[0].dtype
    corners = (jnp.asarray(walls.lower, dtype), jnp.asarray(walls.upper, dtype))
    furthest = jnp.full(places[0].shape, jnp.inf, dtype)
    return jax.lax.scan(nearer, furthest, corners, unroll=FEW_WALLS)[0]


def least_distance(walls: Walls, points: jax.Array) -> jax.Array:
    """The least `wall_distance` () m of few points (N, 3) m, quick for many walls.

    It is one reduction over walls that lie side by side in memory. The points should be there already:
    XLA would compute what they come from anew for every wall.
    """
    lower, upper = (jnp.asarray(corners, points.dtype).T[:, None] for corners in walls)
    places = points.T[:, :, None]
    beyond = [
        jnp.maximum(jnp.maximum(lower[axis] - places[axis], places[axis] - upper[axis]), 0)
        for axis in range(3)
    ]
    return jnp.sqrt(jnp.min(beyond[0] ** 2 + beyond[1] ** 2 + beyond[2] ** 2))
