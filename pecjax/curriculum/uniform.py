"""Uniform: every configuration equally likely, the paper's baseline ("w/o PEC")."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.counts import from_counts


@dataclass(frozen=True)
class Uniform(SamplerSettings):
    """Draws every configuration with probability 1 / N."""

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return uniform(num_configs)


def uniform(num_configs: int) -> Sampler:
    """Draws every configuration with probability 1 / N.

    It also counts trials and failures, so that its failure ratios can be compared with those of other
    samplers. It draws as PEC does: with one key, both begin a training alike.

    Raises:
        InputError: fewer than one configuration.
    """

    def priority(trials: jax.Array, failures: jax.Array, numbers: dict[str, jax.Array]) -> jax.Array:
        return jnp.ones(trials.shape)

    return from_counts(num_configs, {}, priority)
