"""The sampler's contract, and the tally of outcomes that every sampler learns from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp


class Outcomes(NamedTuple):
    """What became of some environments, in arrays of any one shape.

    Attributes:
        config_id: int, the configuration that the running episode was reset with.
        done: bool or 0/1, whether the episode ended here; the others do not count.
        failed: bool or 0/1, whether it ended in failure.
    """

    config_id: jax.Array
    done: jax.Array
    failed: jax.Array


class Sampler(NamedTuple):
    """A way to choose configurations: four pure functions over a state that is a pytree.

    Attributes:
        init: () -> state.
        probabilities: (state) -> (N,), sums to 1.
        sample: (state, key, shape) -> int32 configuration numbers of that shape.
        update: (state, outcomes, axis_name=None) -> state; with an axis name, the outcomes of
            all devices on that mesh axis are summed.
    """

    init: Callable[[], Any]
    probabilities: Callable[[Any], jax.Array]
    sample: Callable[..., jax.Array]
    update: Callable[..., Any]


def tally(outcomes: Outcomes, num_configs: int, axis_name: str | None = None) -> jax.Array:
    """Counts (2, N) int32 of trials and of failures per configuration, by segment sums.

    A trial counts when its episode ends; duplicates add up.
    """
    ids = outcomes.config_id.ravel()
    done = outcomes.done.ravel().astype(bool)
    failed = done & outcomes.failed.ravel().astype(bool)
    counts = jnp.stack([
        jax.ops.segment_sum(flags.astype(jnp.int32), ids, num_segments=num_configs)
        for flags in (done, failed)
    ])  # fmt: skip
    return counts if axis_name is None else jax.lax.psum(counts, axis_name)


def choose(probabilities: jax.Array, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Configuration numbers of the given shape, drawn independently with replacement."""
    num_configs = probabilities.shape[0]
    return jax.random.choice(key, num_configs, shape, p=probabilities).astype(jnp.int32)
