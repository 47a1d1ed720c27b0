"""The probability simplex whose every part is at least a floor: the nearest point of it."""

from __future__ import annotations

import jax
import jax.numpy as jnp

MOST_ROUNDS = 40  # of about ten that are ever needed


def project(point: jax.Array, floor: float) -> jax.Array:
    """The nearest (N,) to a point that sums to 1 and is nowhere below `floor`, at most 1 / N.

    Without sorting: of those above the floor, all give the same amount; who falls below it by that leaves
    them, until nobody does (Michelot 1986).
    """
    left = 1 - floor * point.shape[0]
    shifted = point - floor

    def excess(above: jax.Array) -> jax.Array:
        return (jnp.where(above, shifted, 0.0).sum() - left) / jnp.maximum(above.sum(), 1)

    def smaller(carry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        amount, _, rounds = carry
        later = jnp.maximum(excess(shifted > amount), amount)
        return later, amount, rounds + 1

    first = excess(jnp.ones(point.shape, bool))
    amount, _, _ = jax.lax.while_loop(
        lambda carry: (carry[0] > carry[1]) & (carry[2] < MOST_ROUNDS),
        smaller,
        (first, jnp.full_like(first, -jnp.inf), jnp.int32(0)),
    )
    return jnp.maximum(shifted - amount, 0.0) + floor
