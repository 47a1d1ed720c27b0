"""Initializers: how kernels of layers begin."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

Initializer = Callable[..., jax.Array]


def normc(scale: float) -> Initializer:
    """Normal columns scaled to length `scale` (RLlib 0.8.5, `models/tf/misc.py`)."""

    def init(key: jax.Array, shape: tuple[int, ...], dtype: np.dtype = jnp.float32) -> jax.Array:
        weights = jax.random.normal(key, shape, dtype)
        return scale * weights / jnp.linalg.norm(weights, axis=0, keepdims=True)

    return init


def side_by_side(init: Initializer, number: int) -> Initializer:
    """So many kernels, each by the initializer, in one: of layers that read the same."""

    def kernels(key: jax.Array, shape: tuple[int, ...], dtype: np.dtype = jnp.float32) -> jax.Array:
        keys = jax.random.split(key, number)
        parts = [init(k, (*shape[:-1], shape[-1] // number), dtype) for k in keys]
        return jnp.concatenate(parts, axis=-1)

    return kernels
