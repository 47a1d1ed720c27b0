"""The best of a table without sorting it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

LOOKED_AT = 4096  # the most configurations that are sorted


def best_share(scores: jax.Array, share: jax.Array) -> jax.Array:
    """How the draws from the best `share` of a table are spread over it: (N,) that sums to 1.

    What is above the threshold is drawn alike; equal scores at it fill what is left of the share. The
    threshold is found by sorting: up to `LOOKED_AT` configurations all, of more so many of them, picked once
    at random. There the share is met but for 0.01 or so, and each that is above is drawn by as much more or
    less.

    Args:
        scores: (N,) finite.
        share: () of the places, above 0, 1 at most.
    """
    number = scores.shape[0]
    looked_at = scores
    if number > LOOKED_AT:
        looked_at = scores[np.random.default_rng(0).integers(number, size=LOOKED_AT)]
    last = jnp.ceil(share * looked_at.shape[0]).astype(jnp.int32)
    threshold = jnp.sort(looked_at, descending=True)[jnp.maximum(last - 1, 0)]
    is_above, is_at = scores > threshold, scores == threshold
    wanted, above, at = share * number, is_above.sum(), is_at.sum()
    of_at = jnp.clip((wanted - above) / jnp.maximum(at, 1), 0, 1)
    return jnp.where(is_above, 1.0, jnp.where(is_at, of_at, 0.0)) / (above + at * of_at)
