"""Samplers that follow from statistics of each configuration, learned from trials and failures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler, count_outcomes
from pecjax.curriculum.draws import sample_ids
from pecjax.curriculum.numbers import Numbers, scalars
from pecjax.errors import InputError

# (outcomes, N, axis name) -> what it learns from, summed over the devices of that axis
Hear = Callable[[Outcomes, int, str | None], Any]
# (statistics, what it heard, numbers) -> statistics
Learn = Callable[[Any, Any, Numbers], Any]
# (statistics, numbers) -> (N,) 0 or more
Weight = Callable[[Any, Numbers], jax.Array]


class StatisticsState(NamedTuple):
    """All that such a sampler remembers.

    Attributes:
        statistics: a pytree, mostly of arrays whose last axis is the configurations.
        numbers: () float32 each, by name; kept here so that a study over them is a `vmap`.
    """

    statistics: Any
    numbers: Numbers


def from_statistics(
    num_configs: int,
    numbers: Mapping[str, Any],
    begin: Callable[[], Any],
    learn: Learn,
    weight: Weight,
    hear: Hear = count_outcomes,
    each_alone: bool = False,
) -> Sampler:
    """Draws each configuration in proportion to a weight that follows from its statistics.

    Where every weight is 0 it draws uniformly.

    Args:
        num_configs: N, at least 1.
        numbers: what it is tuned by: scalars (several by `vmap`).
        begin: () -> statistics of configurations that nobody has tried.
        learn: (statistics, what it heard, numbers) -> statistics.
        weight: (statistics, numbers) -> (N,) 0 or more.
        hear: (outcomes, N, axis name) -> what it learns from; trials and failures (2, N) int32, unless it is
            another function.
        each_alone: whether `learn` treats each configuration by itself, with arrays whose last axis is the
            configurations, and leaves what has no outcome as it is. It is then worked out for those of the
            batch only, which is most of the work saved where there are many others.

    Raises:
        InputError: fewer than one configuration.
    """
    if num_configs < 1:
        raise InputError(f"num_configs is {num_configs}; a sampler needs at least 1 configuration")

    def init(**changes: Any) -> StatisticsState:
        return StatisticsState(begin(), scalars(numbers, changes))

    def probabilities(state: StatisticsState) -> jax.Array:
        return normalized(weight(state.statistics, state.numbers))

    def sample(state: StatisticsState, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
        return sample_ids(probabilities(state), key, shape)

    def update(state: StatisticsState, outcomes: Outcomes, axis_name: str | None = None) -> StatisticsState:
        heard = hear(outcomes, num_configs, axis_name)
        ids = jnp.ravel(jnp.asarray(outcomes.config_id))
        # On one of several devices nobody knows what the others' outcomes are of.
        if not each_alone or axis_name is not None or ids.size >= num_configs:
            return state._replace(statistics=learn(state.statistics, heard, state.numbers))
        known, heard = jax.tree.map(lambda leaf: leaf[..., ids], (state.statistics, heard))
        learned = learn(known, heard, state.numbers)
        statistics = jax.tree.map(
            lambda leaf, rows: leaf.at[..., ids].set(rows), state.statistics, learned
        )  # several outcomes of one configuration write the same
        return state._replace(statistics=statistics)

    return Sampler(init, probabilities, sample, update)


def normalized(weight: jax.Array) -> jax.Array:
    """Weights (N,) 0 or more as probabilities; uniform ones where every weight is 0."""
    total = weight.sum()
    return jnp.where(total > 0, weight / jnp.where(total > 0, total, 1.0), 1 / weight.shape[0])
