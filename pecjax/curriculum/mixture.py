"""A mixture: each draw comes from one of several samplers, by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax

from pecjax.curriculum.base import Outcomes, Sampler, SamplerSettings
from pecjax.curriculum.draws import sample_ids
from pecjax.curriculum.learnability import Learnability
from pecjax.curriculum.nested import inner_numbers, num_configs_of
from pecjax.curriculum.numbers import check_number, scalars
from pecjax.curriculum.pec import PEC
from pecjax.errors import InputError


@dataclass(frozen=True)
class Mixture(SamplerSettings):
    """Draws from one of two samplers, by chance (see `mixture`).

    Attributes:
        first, second: the samplers; both learn from every episode.
        share: of the draws that come from the first.
    """

    first: SamplerSettings = field(default_factory=PEC)
    second: SamplerSettings = field(default_factory=Learnability)
    share: float = 0.5

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        both = {"first": self.first.make(num_configs), "second": self.second.make(num_configs)}
        return mixture(both, self.share)


class MixtureState(NamedTuple):
    """The states of all, by name, and the share of the first."""

    samplers: dict[str, Any]
    numbers: dict[str, jax.Array]


def mixture(samplers: dict[str, Sampler], share: Any = 0.5) -> Sampler:
    """Draws from the first of two samplers with chance `share`, else from the second; both learn from all.

        P_n = share * P1_n + (1 - share) * P2_n

    Its numbers are `share` and, as NAME.NUMBER, those of the samplers. For three or more, mix a mixture.

    Args:
        samplers: two, by name.

    Raises:
        InputError: there are not two samplers of the same size, or the share is not from 0 to 1.
    """
    if len(samplers) != 2:
        raise InputError(f"mixture: {len(samplers)} samplers; give two by name, and a mixture as one of them")
    check_number("share", share, 0, 1)
    (first, one), (second, other) = samplers.items()
    sizes = num_configs_of(one), num_configs_of(other)
    if sizes[0] != sizes[1]:
        raise InputError(f"mixture: {first} is over {sizes[0]} configurations, {second} over {sizes[1]}")

    def init(**changes: Any) -> MixtureState:
        of_first, changes = inner_numbers(first, changes)
        of_second, changes = inner_numbers(second, changes)
        states = {first: one.init(**of_first), second: other.init(**of_second)}
        return MixtureState(states, scalars({"share": share}, changes))

    def probabilities(state: MixtureState) -> jax.Array:
        of_first = state.numbers["share"]
        return of_first * one.probabilities(state.samplers[first]) + (1 - of_first) * other.probabilities(
            state.samplers[second]
        )

    def sample(state: MixtureState, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
        return sample_ids(probabilities(state), key, shape)

    def update(state: MixtureState, outcomes: Outcomes, axis_name: str | None = None) -> MixtureState:
        states = state.samplers
        return state._replace(samplers={
            first: one.update(states[first], outcomes, axis_name),
            second: other.update(states[second], outcomes, axis_name),
        })  # fmt: skip

    return Sampler(init, probabilities, sample, update)
