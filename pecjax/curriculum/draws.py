"""Draws in proportion to given probabilities, exact even for a million configurations."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

# One draw by `jax.random.choice` tells about 2²³ places of the whole apart, the grain of a float32
# uniform. That is plenty for so many configurations, and far too little for a million.
MAX_AT_ONCE = 4096
BRANCHES = 32  # of every level below


def sample_ids(weights: jax.Array, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
    """Configuration numbers drawn independently, with replacement, in proportion to `weights`.

    Up to `MAX_AT_ONCE` configurations it draws what `jax.random.choice` draws. More are put into blocks of
    `BRANCHES`, and these into larger ones, until there are few enough for it; it draws one of the
    largest, and a uniform number for every level below finds the place within. So each level has a
    grain of its own, and none of N configurations is out of reach. Takes O(N) once for all draws.

    Args:
        weights: (N,) 0 or more, with any sum; where all are 0 it draws uniformly.
        shape: of the result.

    Returns:
        int32, of the given shape.
    """
    shape = tuple(np.atleast_1d(np.asarray(shape, int)).tolist())
    # Seen as a constant of the program, a large table would be summed up while it is compiled.
    mass = jax.lax.optimization_barrier(weights)
    levels: list[jax.Array] = []  # (blocks, BRANCHES) each, the finest first
    while mass.shape[0] > MAX_AT_ONCE:
        levels.append(jnp.pad(mass, (0, -mass.shape[0] % BRANCHES)).reshape(-1, BRANCHES))
        mass = levels[-1].sum(axis=1)
    key, key_below = jax.random.split(key) if levels else (key, key)
    ids = choose(key, normalized(mass), shape)
    if not levels:
        return ids
    # (1 - u) of [0, 1) is above 0, as `jax.random.choice` has it: what has no mass is never reached.
    uniforms = 1 - jax.random.uniform(key_below, (len(levels), *shape))
    for level, uniform in zip(reversed(levels), uniforms, strict=True):
        ids = ids * BRANCHES + _place_within(jnp.moveaxis(level[ids], -1, 0), uniform)
    uniform_ids = jax.random.randint(key, shape, 0, weights.shape[0])
    return jnp.where(mass.sum() > 0, ids, uniform_ids)


def choose(key: jax.Array, probabilities: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """`jax.random.choice` of N numbers, to the bit, with a search that takes a fraction of its time."""
    running = jnp.cumsum(probabilities)
    reached = running[-1] * (1 - jax.random.uniform(key, shape, running.dtype))
    return jnp.searchsorted(running, reached, method="scan_unrolled").astype(jnp.int32)


def normalized(weight: jax.Array) -> jax.Array:
    """Weights (N,) 0 or more as probabilities; uniform ones where every weight is 0."""
    total = weight.sum()
    return jnp.where(total > 0, weight / jnp.where(total > 0, total, 1.0), 1 / weight.shape[0])


def _place_within(mass: jax.Array, uniform: jax.Array) -> jax.Array:
    """Where (...) in masses (BRANCHES, ...) the running sum first reaches so much of the whole.

    Row by row, in one loop over all draws: a quarter of the time of sums along the rows.
    """
    running = list(itertools.accumulate(mass))
    is_before = jnp.stack(running) < uniform * running[-1]
    # Counted as a product: fused with all that use the place, a sum would be worked out for each anew.
    return jnp.tensordot(jnp.ones(BRANCHES), is_before.astype(jnp.float32), 1).astype(jnp.int32)
