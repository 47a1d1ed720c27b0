"""Matrix products with operands of 16 bits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def bfloat16_product(columns: jax.Array | None = None) -> Callable[..., jax.Array]:
    """The product of rows (…, I) and a kernel (I, O) for a dense layer, in place of `jax.lax.dot_general`.

    Its operands are rounded to bfloat16, and those of its gradients too where that saves time on a CPU, which
    knows no products of 16 bits of a matrix whose rows lie across memory. Sums are float32.

    Args:
        columns: (I, N), the rows (N, I) transposed in memory, for the kernel's gradient: it is of operands of
            32 bits without them.
    """

    def product(x: jax.Array, kernel: jax.Array, dimension_numbers: Any, precision: Any = None) -> jax.Array:
        rows = x.reshape(-1, x.shape[-1])
        return _product(rows, columns, kernel).reshape(*x.shape[:-1], kernel.shape[-1])

    return product


@jax.custom_vjp
def _product(rows: jax.Array, columns: jax.Array | None, kernel: jax.Array) -> jax.Array:
    return _times(rows, kernel)


def _times(a: jax.Array, b: jax.Array, over: int = 0) -> jax.Array:
    """The product of a and b, summed over the last axis of a and the axis `over` of b."""
    a, b = a.astype(jnp.bfloat16), b.astype(jnp.bfloat16)
    return jax.lax.dot_general(a, b, (((1,), (over,)), ((), ())), preferred_element_type=jnp.float32)


def _forward(rows: jax.Array, columns: jax.Array | None, kernel: jax.Array) -> tuple[jax.Array, tuple]:
    return _times(rows, kernel), (rows, columns, kernel)


def _backward(kept: tuple, gradient: jax.Array) -> tuple[jax.Array, jax.Array | None, jax.Array]:
    rows, columns, kernel = kept
    of_rows = _times(gradient, kernel, over=1).astype(rows.dtype)
    if columns is None:
        return of_rows, None, rows.astype(jnp.float32).T @ gradient
    return of_rows, jnp.zeros_like(columns), _times(columns, gradient)


_product.defvjp(_forward, _backward)
