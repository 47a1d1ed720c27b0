"""Sensing: what the drone sees of its map and knows of its goal."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pecjax.envs.rooms.depth import render_depth
from pecjax.envs.rooms.maps import Walls
from pecjax.envs.rooms.rotations import heading
from pecjax.envs.rooms.vehicle import Camera

DISTANCE_SCALE = 10.0  # m; brings the distance to the goal near 1


def sense(
    camera: Camera, walls: Walls, position: jax.Array, quaternion: jax.Array, goal: jax.Array
) -> dict[str, jax.Array]:
    """The observation in SI units.

    Args:
        position, quaternion: (3,) m and (4,) w-x-y-z of the drone.
        goal: (2,) m.

    Returns:
        `depth` (H, W) m and `goal` (2,): level distance to the goal in m, and its bearing off the
        heading in rad, in [-π, π), positive to the left.
    """
    offset = goal - position[:2]
    bearing = jnp.arctan2(offset[1], offset[0]) - heading(quaternion)
    towards = jnp.stack([jnp.linalg.norm(offset), (bearing + jnp.pi) % (2 * jnp.pi) - jnp.pi])
    return {"depth": render_depth(camera, walls, position, quaternion), "goal": towards}


def scale(seen: dict[str, jax.Array], far: float) -> dict[str, jax.Array]:
    """The observation near the unit range, for networks.

    Args:
        seen: of `sense`, with leading axes or without.
        far: m, the depth that becomes 1.

    Returns:
        `depth` (…, H, W), and `goal` (…, 3): distance, and sine and cosine of the bearing, which have
        no jump behind the drone; what else there is as it was.
    """
    distance, bearing = seen["goal"][..., 0], seen["goal"][..., 1]
    goal = jnp.stack([distance / DISTANCE_SCALE, jnp.sin(bearing), jnp.cos(bearing)], axis=-1)
    return seen | {"depth": seen["depth"] / far, "goal": goal}
