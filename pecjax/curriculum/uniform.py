"""Uniform: every configuration equally likely, the paper's baseline ("w/o PEC")."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler, check_num_configs, count_outcomes
from pecjax.curriculum.draws import sample_ids


class UniformState(NamedTuple):
    """What came of the draws, which do not depend on it.

    Attributes:
        counts: (2, N) int32, trials and failures over the whole training: the failure ratios of a
            baseline, to compare another sampler's with.
    """

    counts: jax.Array


def uniform(num_configs: int) -> Sampler:
    """Draws every configuration with probability 1 / N.

    Raises:
        InputError: fewer than one configuration.
    """
    check_num_configs(num_configs)

    def init() -> UniformState:
        return UniformState(jnp.zeros((2, num_configs), jnp.int32))

    def probabilities(state: UniformState) -> jax.Array:
        return jnp.full(num_configs, 1 / num_configs)

    def sample(state: UniformState, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
        # As PEC draws: with one key, both begin a training with the same configurations.
        return sample_ids(probabilities(state), key, shape)

    def update(state: UniformState, outcomes: Outcomes, axis_name: str | None = None) -> UniformState:
        return UniformState(state.counts + count_outcomes(outcomes, num_configs, axis_name))

    return Sampler(init, probabilities, sample, update)
