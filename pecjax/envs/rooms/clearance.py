"""Clearance: how far a point is from the nearest wall."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pecjax.envs.rooms.maps import FEW_WALLS, Walls


def wall_distance(walls: Walls, points: jax.Array) -> jax.Array:
    """Distance (…,) m from points (…, 3) m to the nearest wall, 0 inside one.

    A sphere of radius r around a point touches a wall where this is at most r.
    Oracle: C MuJoCo's sphere-box contacts.
    """

    def nearer(best: jax.Array, wall: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        lower, upper = wall
        beyond = [
            jnp.maximum(jnp.maximum(lower[axis] - points[..., axis], points[..., axis] - upper[axis]), 0)
            for axis in range(3)
        ]
        return jnp.minimum(best, beyond[0] ** 2 + beyond[1] ** 2 + beyond[2] ** 2), None

    corners = (jnp.asarray(walls.lower, points.dtype), jnp.asarray(walls.upper, points.dtype))
    furthest = jnp.full(points.shape[:-1], jnp.inf, points.dtype)
    return jnp.sqrt(jax.lax.scan(nearer, furthest, corners, unroll=FEW_WALLS)[0])


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
