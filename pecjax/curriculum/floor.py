"""A floor: a share of the draws is uniform, whatever a sampler has learned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler, SamplerSettings
from pecjax.curriculum.learnability import Learnability
from pecjax.curriculum.nested import inner_numbers, num_configs_of
from pecjax.curriculum.numbers import check_number, scalars


@dataclass(frozen=True)
class Floor(SamplerSettings):
    """Draws uniformly with chance ε, and by another sampler otherwise (see `floor`).

    Attributes:
        sampler: the other one.
        epsilon: ε, the share of uniform draws.
    """

    sampler: SamplerSettings = field(default_factory=Learnability)
    epsilon: float = 0.1

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return floor(self.sampler.make(num_configs), self.epsilon)


class FloorState(NamedTuple):
    """The other sampler's state, and ε."""

    sampler: Any
    numbers: dict[str, jax.Array]


def floor(sampler: Sampler, epsilon: Any = 0.1) -> Sampler:
    """Draws uniformly with chance ε, and by the sampler otherwise; no probability is below ε / N.

        P_n = (1 - ε) P'_n + ε / N

    Its numbers are `epsilon` and, as `sampler.NAME`, those of the sampler.

    Raises:
        InputError: ε is not from 0 to 1.
    """
    check_number("epsilon", epsilon, 0, 1)
    num_configs = num_configs_of(sampler)

    def init(**changes: Any) -> FloorState:
        inner, own = inner_numbers("sampler", changes)
        return FloorState(sampler.init(**inner), scalars({"epsilon": epsilon}, own))

    def probabilities(state: FloorState) -> jax.Array:
        share = state.numbers["epsilon"]
        return (1 - share) * sampler.probabilities(state.sampler) + share / num_configs

    def sample(state: FloorState, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
        key, key_which, key_any = jax.random.split(key, 3)
        ids = sampler.sample(state.sampler, key, shape)
        is_any = jax.random.bernoulli(key_which, state.numbers["epsilon"], ids.shape)
        return jnp.where(is_any, jax.random.randint(key_any, ids.shape, 0, num_configs), ids)

    def update(state: FloorState, outcomes: Outcomes, axis_name: str | None = None) -> FloorState:
        return state._replace(sampler=sampler.update(state.sampler, outcomes, axis_name))

    return Sampler(init, probabilities, sample, update)
