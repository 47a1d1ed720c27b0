"""Groups: similar configurations share what a sampler learns about them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.curriculum.base import Outcomes, Sampler, check_outcomes
from pecjax.curriculum.nested import num_configs_of
from pecjax.errors import InputError


def by_group(sampler: Sampler, groups: Any) -> Sampler:
    """Draws a group with the sampler, and then one of its configurations evenly.

        P_n = P'_g / |g|,   g the group of n

    So a million configurations can learn from their neighbours. Numbers and state are those of the sampler.

    Example:
        groups = bins([table.wind[:, 0], table.payload], 4)
        sampler = by_group(learnability(groups.max() + 1), groups)

    Args:
        sampler: over G groups.
        groups: (N,) int from 0 to G - 1, each at least once.

    Raises:
        InputError: the groups are not of this form.
    """
    groups = np.asarray(groups)
    if groups.ndim != 1 or not groups.size or not np.issubdtype(groups.dtype, np.integer):
        raise InputError(f"groups have shape {groups.shape} and type {groups.dtype}; give (N,) integers")
    if groups.min() < 0:
        raise InputError(f"groups: {groups.min()} is no group; they are counted from 0")
    sizes = np.bincount(groups)
    if not sizes.all():
        raise InputError(f"groups: no configuration is in group {int(np.argmin(sizes))}; leave none out")
    known = num_configs_of(sampler)
    if known != len(sizes):
        raise InputError(f"groups: there are {len(sizes)}, and the sampler is over {known}")
    members = jnp.asarray(np.argsort(groups, kind="stable"), jnp.int32)
    starts = jnp.asarray(np.cumsum(sizes) - sizes, jnp.int32)
    group_of, size_of = jnp.asarray(groups, jnp.int32), jnp.asarray(sizes, jnp.int32)

    def probabilities(state: Any) -> jax.Array:
        return (sampler.probabilities(state) / size_of)[group_of]

    def sample(state: Any, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
        key_group, key_member = jax.random.split(key)
        chosen = sampler.sample(state, key_group, shape)
        place = jax.random.randint(key_member, chosen.shape, 0, size_of[chosen])
        return members[starts[chosen] + place]

    def update(state: Any, outcomes: Outcomes, axis_name: str | None = None) -> Any:
        check_outcomes(outcomes, len(groups))
        ids = jnp.asarray(outcomes.config_id)
        # What is traced may hold anything: what does not exist belongs to no group, and is dropped there.
        exists = (ids >= 0) & (ids < len(groups))
        of_group = jnp.where(exists, group_of[jnp.clip(ids, 0, len(groups) - 1)], len(sizes))
        done = jnp.asarray(outcomes.done).astype(bool) & exists
        return sampler.update(state, outcomes._replace(config_id=of_group, done=done), axis_name)

    return Sampler(sampler.init, probabilities, sample, update)


def bins(columns: Sequence[Any], number: int) -> np.ndarray:
    """Groups (N,) of configurations that lie in the same bin of every column.

    Args:
        columns: of the table, (N,) each.
        number: of bins of a column, with about equally many configurations in each; equal values stay
            together.

    Returns:
        Integers from 0; only combinations that occur are groups.

    Raises:
        InputError: there are no columns or no bins, or the columns differ in length.
    """
    arrays = [np.asarray(column) for column in columns]
    if not arrays:
        raise InputError("bins: no columns; give one at least")
    for array in arrays:
        if array.ndim != 1 or array.shape != arrays[0].shape:
            raise InputError(f"bins: columns have shapes {arrays[0].shape} and {array.shape}; give (N,) each")
    if number < 1:
        raise InputError(f"bins: {number} bins; give 1 or more")
    places = []
    for column in arrays:
        edges = np.unique(np.quantile(column, np.arange(1, number) / number, method="inverted_cdf"))
        places.append(np.searchsorted(edges, column, side="left"))
    _, groups = np.unique(np.stack(places), axis=1, return_inverse=True)
    return groups.reshape(-1)
