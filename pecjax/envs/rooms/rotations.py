"""Rotations: unit quaternions (w-x-y-z, as in MuJoCo) and what they stand for."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp


def quaternion_to_matrix(quaternion: jax.Array) -> jax.Array:
    """The rotation matrix (3, 3) of a unit quaternion (4,): columns are the turned axes."""
    return jnp.array(rotation_rows(quaternion))


def rotation_rows(quaternion: Any) -> tuple[tuple[Any, ...], ...]:
    """The rows of `quaternion_to_matrix`, scalar by scalar."""
    w, x, y, z = quaternion
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def quaternion_product(p: Any, q: Any) -> tuple[Any, ...]:
    """The quaternion p ⊗ q, which turns by q and then by p, scalar by scalar."""
    (a, b, c, d), (w, x, y, z) = p, q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def dot(a: Any, b: Any) -> Any:
    """The product () of two vectors of one short length.

    Written out: under `vmap`, XLA turns `a @ b` into a batched product that fuses with nothing.
    """
    return sum((x * y for x, y in zip(a[1:], b[1:], strict=True)), start=a[0] * b[0])


def cross(a: Any, b: Any) -> tuple[Any, ...]:
    """The cross product of two vectors of three, scalar by scalar."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def heading_to_quaternion(heading: jax.Array) -> jax.Array:
    """The quaternion (4,) of a level body that looks along `heading` (rad, from +x towards +y)."""
    zero = jnp.zeros_like(heading)
    return jnp.stack([jnp.cos(heading / 2), zero, zero, jnp.sin(heading / 2)])


def heading(quaternion: jax.Array) -> jax.Array:
    """The direction (rad, in [-π, π]) of the body's x axis seen from above."""
    w, x, y, z = quaternion
    return jnp.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
