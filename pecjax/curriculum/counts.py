"""Samplers that know the counts of trials and failures, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler, count_outcomes
from pecjax.curriculum.draws import sample_ids
from pecjax.errors import InputError

# (trials (N,), failures (N,), numbers) -> (N,) 0 or more
Priority = Callable[[jax.Array, jax.Array, dict[str, jax.Array]], jax.Array]


class CountsState(NamedTuple):
    """All that such a sampler remembers.

    Attributes:
        counts: (2, N) int32, trials and failures over the whole training.
        numbers: () float32 each, by name; kept here so that a study over them is a `vmap`.
    """

    counts: jax.Array
    numbers: dict[str, jax.Array]


def from_counts(num_configs: int, numbers: Mapping[str, Any], priority: Priority) -> Sampler:
    """Draws each configuration in proportion to a priority that follows from its counts.

    Where every priority is 0 it draws uniformly.

    Args:
        num_configs: N, at least 1.
        numbers: what `priority` is tuned by: scalars (several by `vmap`).

    Raises:
        InputError: fewer than one configuration.
    """
    if num_configs < 1:
        raise InputError(f"num_configs is {num_configs}; a sampler needs at least 1 configuration")

    def init(**changes: Any) -> CountsState:
        if unknown := set(changes) - set(numbers):
            raise InputError(f"the sampler has no {', '.join(sorted(unknown))}; it has {[*numbers]}")
        own = {name: jnp.asarray(value, jnp.float32) for name, value in {**numbers, **changes}.items()}
        return CountsState(jnp.zeros((2, num_configs), jnp.int32), own)

    def probabilities(state: CountsState) -> jax.Array:
        weight = priority(state.counts[0], state.counts[1], state.numbers)
        total = weight.sum()
        return jnp.where(total > 0, weight / jnp.where(total > 0, total, 1.0), 1 / num_configs)

    def sample(state: CountsState, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
        return sample_ids(probabilities(state), key, shape)

    def update(state: CountsState, outcomes: Outcomes, axis_name: str | None = None) -> CountsState:
        return state._replace(counts=state.counts + count_outcomes(outcomes, num_configs, axis_name))

    return Sampler(init, probabilities, sample, update)
