"""Successes and failures that fade: each trial of a configuration makes its earlier ones count less."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler
from pecjax.curriculum.numbers import check_number
from pecjax.curriculum.statistics import Weight, from_statistics


def from_memory(num_configs: int, numbers: Mapping[str, Any], weight: Weight) -> Sampler:
    """Draws each configuration in proportion to a weight computed from successes and failures that fade.

    The statistics are (2, N) float32, of `remember`.

    Args:
        num_configs: N, at least 1.
        numbers: the scalars that tune it (several by `vmap`), `half_life` among them.
        weight: (statistics, numbers) -> (N,) 0 or more. Where all are 0, draws are uniform.

    Raises:
        InputError: fewer than one configuration, or a half-life that is not above 0.
    """
    check_number("half_life", numbers["half_life"], 0, above=True)
    return from_statistics(
        num_configs,
        numbers,
        begin=lambda: begin_memory(num_configs),
        learn=lambda memory, counts, own: remember(memory, counts, own["half_life"]),
        weight=weight,
        each_alone=True,
    )


def begin_memory(num_configs: int) -> jax.Array:
    """Of configurations that nobody has tried: (2, N) float32, successes and failures."""
    return jnp.zeros((2, num_configs), jnp.float32)


def remember(memory: jax.Array, counts: jax.Array, half_life: jax.Array) -> jax.Array:
    """Adds a batch; an outcome's weight is halved by every `half_life` later trials of its configuration.

    Nobody knows the order of the trials within a batch: their outcomes share their weights evenly.

    Args:
        memory: (2, N) successes and failures.
        counts: (2, N) int, trials and failures of the batch.
        half_life: () trials, above 0; with infinity nothing fades.
    """
    trials, failures = counts[0].astype(jnp.float32), counts[1].astype(jnp.float32)
    kept, share = fading(trials, half_life)
    return kept * memory + share * jnp.stack([trials - failures, failures])


def average(before: jax.Array, counts: jax.Array, half_life: jax.Array) -> jax.Array:
    """Moves averages of failures (N,) on by a batch's counts (2, N) of trials and failures."""
    trials = counts[0].astype(jnp.float32)
    kept, _ = fading(trials, half_life)
    return kept * before + (1 - kept) * counts[1] / jnp.maximum(trials, 1.0)


def fading(trials: jax.Array, half_life: jax.Array) -> tuple[jax.Array, jax.Array]:
    """What so many more trials (N,) leave of an earlier one's weight, and what each of them weighs."""
    rate = -jnp.log(2.0) / half_life
    forgotten = -jnp.expm1(rate * trials)
    fades = (rate < 0) & (trials > 0)
    share = jnp.where(fades, forgotten / jnp.where(fades, -jnp.expm1(rate) * trials, 1.0), 1.0)
    return 1 - forgotten, share
