"""What fading successes and failures tell of a chance of success: the Beta posterior."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def beta_parameters(memory: jax.Array, prior: float) -> tuple[jax.Array, jax.Array]:
    """The a and b (N,) of Beta(a, b), from successes and failures (2, N) and a prior Beta(prior, prior)."""
    return memory[0] + prior, memory[1] + prior


def beta_draws(key: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    """Draws (N,) from Beta(a, b), nearly, for a and b of 1 or more: X / (X + Y) of two gamma variates.

    These are cubes of normal ones (Wilson & Hilferty 1931): no distribution function is off by more than
    0.02. Exact draws of a million take a second.
    """
    normal = jax.random.normal(key, (2, *a.shape))
    x, y = (_gamma(shape, z) for shape, z in zip((a, b), normal, strict=True))
    return x / (x + y)


def _gamma(shape: jax.Array, normal: jax.Array) -> jax.Array:
    return shape * jnp.maximum(1 - 1 / (9 * shape) + normal / (3 * jnp.sqrt(shape)), 1e-3) ** 3


def gain_of_retries(success: jax.Array, tries: jax.Array) -> jax.Array:
    """u_n(p) = 1 - (1 - p)ⁿ - p: how much likelier a success within n tries is than one in the first.

    Zero at p = 0 and 1; p (1 - p) with two tries; the failure ratio 1 - p as n grows, but for p = 0.
    """
    failure = 1 - success
    never = jnp.where(failure > 0, jnp.exp(tries * jnp.log(jnp.maximum(failure, 1e-30))), 0.0)
    return jnp.maximum(failure - never, 0.0)
