"""Samplers that use only the counts of trials and failures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler
from pecjax.curriculum.numbers import Numbers
from pecjax.curriculum.statistics import from_statistics

# (trials (N,), failures (N,), numbers) -> (N,) 0 or more
Priority = Callable[[jax.Array, jax.Array, Numbers], jax.Array]


def from_counts(num_configs: int, numbers: Mapping[str, Any], priority: Priority) -> Sampler:
    """Draws each configuration in proportion to a priority computed from its counts.

    The statistics are (2, N) int32: trials and failures over the whole training. Where every priority is 0,
    draws are uniform.

    Args:
        num_configs: N, at least 1.
        numbers: the scalars that tune `priority` (several by `vmap`).

    Raises:
        InputError: fewer than one configuration.
    """
    return from_statistics(
        num_configs,
        numbers,
        begin=lambda: jnp.zeros((2, num_configs), jnp.int32),
        learn=lambda counts, new, _: counts + new,
        weight=lambda counts, own: priority(counts[0], counts[1], own),
        each_alone=True,
    )
