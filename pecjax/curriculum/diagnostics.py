"""Diagnostics: a sampler's probabilities summarized in a few numbers."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def diagnose(probabilities: jax.Array, counts: jax.Array) -> dict[str, jax.Array]:
    """Summarizes how a sampler spreads its draws.

    Args:
        probabilities: (N,), they sum to 1.
        counts: (2, N), trials and failures of each configuration since the beginning.

    Returns:
        `effective_configs`, the exponential of the entropy: so many, drawn evenly, would be as many;
        `least_probability` and `greatest_probability`, as multiples of the uniform 1 / N;
        `untried`, the share of the configurations that nobody has tried;
        `never_solved`, the share of the draws that go to what was tried and always failed.
    """
    trials, failures = counts
    number = probabilities.shape[0]
    surprise = -jnp.log(jnp.where(probabilities > 0, probabilities, 1.0))
    return {
        "effective_configs": jnp.exp((probabilities * surprise).sum()),
        "least_probability": probabilities.min() * number,
        "greatest_probability": probabilities.max() * number,
        "untried": (trials == 0).mean(),
        "never_solved": jnp.where((trials > 0) & (failures == trials), probabilities, 0.0).sum(),
    }
