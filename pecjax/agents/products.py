"""Matrix products with operands of 16 bits."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp


def bfloat16_product(
    x: jax.Array, kernel: jax.Array, dimension_numbers: Any, precision: Any = None
) -> jax.Array:
    """The product of rows (…, I) and a kernel (I, O), in place of `jax.lax.dot_general` in a dense layer.

    Its operands are rounded to bfloat16, and those of its gradients, too; sums are float32. The other
    arguments are those of a dense layer in any case.
    """
    rows = x.reshape(-1, x.shape[-1])
    return _product(rows, kernel).reshape(*x.shape[:-1], kernel.shape[-1])


@jax.custom_vjp
def _product(rows: jax.Array, kernel: jax.Array) -> jax.Array:
    return _times(rows, kernel)


def _times(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.matmul(a.astype(jnp.bfloat16), b.astype(jnp.bfloat16), preferred_element_type=jnp.float32)


def _forward(rows: jax.Array, kernel: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    return _product(rows, kernel), (rows, kernel)


def _backward(kept: tuple[jax.Array, jax.Array], gradient: jax.Array) -> tuple[jax.Array, jax.Array]:
    rows, kernel = kept
    # Transposed in memory, which takes less time than the product of a transposed matrix loses on a CPU.
    columns = jax.lax.optimization_barrier(rows.astype(jnp.bfloat16).T)
    return _times(gradient, kernel.T).astype(rows.dtype), _times(columns, gradient).astype(kernel.dtype)


_product.defvjp(_forward, _backward)
