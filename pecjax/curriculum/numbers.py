"""A sampler's numbers: their ranges, and how its state keeps them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.errors import InputError

Numbers = dict[str, jax.Array]


def check_number(
    name: str, value: Any, low: float, high: float = np.inf, above: bool = False, finite: bool = False
) -> None:
    """Makes sure that a number is one, from `low` (or, if `above`, beyond it) to `high`.

    What is traced has no value to check.

    Raises:
        InputError: it is not.
    """
    if np.ndim(value):
        raise InputError(f"{name} has shape {np.shape(value)}; give one number, and vmap over several")
    if isinstance(value, jax.core.Tracer):
        return
    if not (low < value if above else low <= value) or not value <= high or (finite and np.isinf(value)):
        begin = f"above {low:g}" if above else f"{low:g} or more" if np.isinf(high) else f"from {low:g}"
        end = (
            (", and finite" if finite else "")
            if np.isinf(high)
            else f", {high:g} at most"
            if above
            else f" to {high:g}"
        )
        raise InputError(f"{name} is {value}; it must be a number {begin}{end}")


def scalars(numbers: Mapping[str, Any], changes: Mapping[str, Any]) -> Numbers:
    """A sampler's own numbers with changes to some of them, as a state keeps them.

    Raises:
        InputError: a change to a number that it does not have.
    """
    if unknown := set(changes) - set(numbers):
        own = ", ".join(numbers) or "no number of its own"
        raise InputError(f"the sampler has no {', '.join(sorted(unknown))}; it has {own}")
    return {name: jnp.asarray(value, jnp.float32) for name, value in {**numbers, **changes}.items()}
