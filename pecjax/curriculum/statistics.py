"""Samplers that use statistics of each configuration, learned from trials and failures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler, count_outcomes
from pecjax.curriculum.draws import normalized, sample_ids
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
    """Draws each configuration in proportion to a weight computed from its statistics.

    Where every weight is 0, draws are uniform.

    Args:
        num_configs: N, at least 1.
        numbers: the scalars that tune it (several by `vmap`).
        begin: () -> statistics of configurations that were never tried.
        learn: (statistics, result of `hear`, numbers) -> statistics.
        weight: (statistics, numbers) -> (N,) 0 or more.
        hear: (outcomes, N, axis name) -> the argument of `learn`. By default it is trials and failures,
            (2, N) int32.
        each_alone: whether `learn` treats each configuration by itself, with arrays whose last axis is the
            configurations, and leaves those without an outcome unchanged. It is then computed for the
            configurations of the batch only (`learn_alone`), which saves most of the work in a large table.

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
        return sample_ids(weight(state.statistics, state.numbers), key, shape)

    def update(state: StatisticsState, outcomes: Outcomes, axis_name: str | None = None) -> StatisticsState:
        heard, numbers = hear(outcomes, num_configs, axis_name), state.numbers
        if not each_alone:
            return state._replace(statistics=learn(state.statistics, heard, numbers))
        ids = ids_in_batch(outcomes, num_configs, axis_name)
        learned = learn_alone(lambda known, new: learn(known, new, numbers), state.statistics, heard, ids)
        return state._replace(statistics=learned)

    return Sampler(init, probabilities, sample, update)


def ids_in_batch(outcomes: Outcomes, num_configs: int, axis_name: str | None) -> jax.Array | None:
    """The configurations (E,) that a batch is of; None where that spares no work.

    On one of several devices nobody knows what the others' outcomes are of.
    """
    ids = jnp.ravel(jnp.asarray(outcomes.config_id))
    return None if axis_name is not None or ids.size >= num_configs else ids


def learn_alone(learn: Callable[[Any, Any], Any], known: Any, heard: Any, ids: jax.Array | None) -> Any:
    """`learn(known, heard)` worked out for the configurations of a batch only, or for all if `ids` is None.

    Args:
        learn: treats each configuration by itself, and leaves one without an outcome as it is.
        known, heard: pytrees of arrays whose last axis is the configurations.
    """
    if ids is None:
        return learn(known, heard)
    learned = learn(*jax.tree.map(lambda leaf: jnp.asarray(leaf)[..., ids], (known, heard)))
    # Several outcomes of one configuration write the same.
    return jax.tree.map(lambda leaf, rows: jnp.asarray(leaf).at[..., ids].set(rows), known, learned)
