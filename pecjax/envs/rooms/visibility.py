"""Visibility: which walls of a map could be in the camera's view."""

from __future__ import annotations

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.rooms.rotations import dot
from pecjax.envs.rooms.vehicle import Camera

_MARGIN = 0.01  # m; far more than what rounding moves a wall by, so that none is lost that a ray meets
_BITS = 32  # of a word


def view_planes(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The planes around all that the rays of the camera meet within its range.

    Returns:
        normals (6, 3), in the drone's frame, and offsets (6,) m: points p (3,) m, as seen from the camera,
        are between them where normals @ p + offsets >= 0.
    """
    pixel = 2 * np.tan(camera.fovy / 2) / camera.height
    right, up = pixel * (camera.width - 1) / 2, pixel * (camera.height - 1) / 2  # to the outermost centres
    ahead, far = [0, 0, -1], [0, 0, 1]
    normals = np.array([ahead, [1, 0, -right], [-1, 0, -right], [0, 1, -up], [0, -1, -up], far])
    return normals @ camera.rotation.T, np.array([0, 0, 0, 0, 0, camera.far])


def could_be_seen(camera: Camera, rotation: jax.Array, lower: jax.Array, upper: jax.Array) -> jax.Array:
    """Whether (W,) a wall is in view, at any attitude, whatever stands before it.

    A wall that is left out is met by no ray within the camera's range. One that is kept may still lie
    beside the view: it is left out only where all of it is beyond one of the planes around the view.

    Args:
        rotation: (3, 3) from the drone's frame to the world.
        lower, upper: (W, 3) m, corners of the walls as seen from the camera, along the world's axes.
    """
    seen = jnp.ones(lower.shape[0], bool)
    normals, offsets = view_planes(camera)
    for normal, offset in zip(normals, offsets, strict=True):
        # Written out, as in `raycast`: with products and sums over the axes it would not be one kernel.
        furthest = jnp.full(lower.shape[0], offset + _MARGIN, lower.dtype)
        for axis in range(3):
            towards = dot(rotation[axis], jnp.asarray(normal, rotation.dtype))
            furthest += jnp.maximum(towards * lower[:, axis], towards * upper[:, axis])
        seen &= furthest >= 0
    return seen


def pack(flags: jax.Array) -> list[jax.Array]:
    """Flags (W,) as words, () uint32 each, the first flag in the lowest bit."""
    words = -(-flags.shape[0] // _BITS)
    rows = jnp.pad(flags, (0, words * _BITS - flags.shape[0])).reshape(words, _BITS)
    powers = jnp.asarray(2 ** np.arange(_BITS, dtype=np.uint64), jnp.uint32)
    packed = jnp.sum(rows.astype(jnp.uint32) * powers, axis=1, dtype=jnp.uint32)
    return [packed[number] for number in range(words)]


def any_left(words: list[jax.Array]) -> jax.Array:
    """Whether () any flag is up."""
    return reduce(jnp.bitwise_or, words) != 0


def take_first(words: list[jax.Array], otherwise: jax.Array) -> tuple[list[jax.Array], jax.Array]:
    """Takes down the first flag that is up.

    Returns:
        the words without it, and () int32, its number; `otherwise` where none was up.
    """
    rest, number, taken = [], otherwise, jnp.zeros((), bool)
    for position, word in enumerate(words):
        lowest = word & (~word + 1)
        here = (word != 0) & ~taken
        below = jax.lax.population_count(lowest - 1).astype(jnp.int32)
        number = jnp.where(here, _BITS * position + below, number)
        rest.append(jnp.where(here, word ^ lowest, word))
        taken |= here
    return rest, number
