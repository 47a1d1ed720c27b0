"""Shares of steps: a sampler's probabilities as shares of time instead of episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler, SamplerSettings, by_config, count_outcomes
from pecjax.curriculum.draws import normalized, sample_ids
from pecjax.curriculum.nested import inner_numbers, num_configs_of
from pecjax.curriculum.numbers import scalars
from pecjax.curriculum.pec import PEC
from pecjax.curriculum.statistics import ids_in_batch, learn_alone


@dataclass(frozen=True)
class PerStep(SamplerSettings):
    """Gives each configuration a share of the steps instead of the episodes (see `per_step`).

    Attributes:
        sampler: the sampler that gives the shares.
    """

    sampler: SamplerSettings = field(default_factory=PEC)

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return per_step(self.sampler.make(num_configs))


class PerStepState(NamedTuple):
    """The other sampler's state, and episodes and steps (2, N) float32 of each configuration."""

    sampler: Any
    totals: jax.Array


def per_step(sampler: Sampler) -> Sampler:
    """Draws so that each configuration's share of the *steps* is the sampler's probability.

        P_n = P'_n / L_n / Σ (P' / L)

    L_n is the mean length of the configuration's episodes since the beginning, or of all episodes where it
    has none. Otherwise, long episodes of failures would take a larger part of a training than their number
    says. Its numbers are those of the sampler, as `sampler.NAME`.

    Raises:
        InputError: raised by an update whose outcomes have no lengths.
    """
    num_configs = num_configs_of(sampler)

    def init(**changes: Any) -> PerStepState:
        inner, unknown = inner_numbers("sampler", changes)
        scalars({}, unknown)
        return PerStepState(sampler.init(**inner), jnp.zeros((2, num_configs)))

    def weights(state: PerStepState) -> jax.Array:
        episodes, steps = state.totals[0], state.totals[1]
        whole = state.totals.sum(axis=1)
        usual = jnp.where(whole[0] > 0, whole[1] / jnp.maximum(whole[0], 1), 1.0)
        length = jnp.where(episodes > 0, steps / jnp.maximum(episodes, 1), usual)
        return sampler.probabilities(state.sampler) / jnp.maximum(length, 1.0)

    def probabilities(state: PerStepState) -> jax.Array:
        return normalized(weights(state))

    def sample(state: PerStepState, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
        return sample_ids(weights(state), key, shape)

    def update(state: PerStepState, outcomes: Outcomes, axis_name: str | None = None) -> PerStepState:
        new = (
            count_outcomes(outcomes, num_configs, axis_name)[0],
            by_config(outcomes, "length", num_configs, axis_name=axis_name),
        )
        ids = ids_in_batch(outcomes, num_configs, axis_name)
        totals = learn_alone(lambda before, heard: before + jnp.stack(heard), state.totals, new, ids)
        return PerStepState(sampler.update(state.sampler, outcomes, axis_name), totals)

    return Sampler(init, probabilities, sample, update)
