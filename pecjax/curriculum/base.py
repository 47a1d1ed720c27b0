"""The sampler's contract: its functions, the outcomes it learns from, and how a run names one."""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.errors import InputError


class Outcomes(NamedTuple):
    """The outcomes of some episodes, in arrays that broadcast against one another.

    Lists and scalars are accepted, and ids (B,) can go with flags (T, B).

    Attributes:
        config_id: int, the configuration that the running episode was reset with.
        done: bool or 0/1, whether the episode ended here. Others do not count.
        failed: bool or 0/1, whether it ended in failure.
        length: int, its number of actions.
        episode_return: the sum of its rewards.
        signal: the learner's own score of the episode, if it has one.
    """

    config_id: Any
    done: Any
    failed: Any
    length: Any = None
    episode_return: Any = None
    signal: Any = None


class Sampler(NamedTuple):
    """A way to choose configurations: four pure functions over a state that is a pytree.

    Attributes:
        init: `(**numbers) -> state`. The sampler's numbers are part of its state, so a study can vary
            them under `vmap`. A number that is given by name replaces the sampler's own.
        probabilities: (state) -> (N,), sums to 1.
        sample: (state, key, shape=()) -> int32 configuration numbers of that shape, a tuple or an
            int. It only reads the state.
        update: (state, outcomes, axis_name=None) -> state; with an axis name, the outcomes of
            all devices on that mesh axis are summed.
    """

    init: Callable[..., Any]
    probabilities: Callable[[Any], jax.Array]
    sample: Callable[..., jax.Array]
    update: Callable[..., Any]


@dataclass(frozen=True)
class SamplerSettings(abc.ABC):
    """A kind of sampler with its numbers. Extend it by a frozen dataclass to use it in a run.

    `PEC` is an example; `examples/own_sampler.py` has one in a file of its own.
    """

    @abc.abstractmethod
    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations.

        Raises:
            InputError: a number out of its range, or no configuration.
        """


def count_outcomes(outcomes: Outcomes, num_configs: int, axis_name: str | None = None) -> jax.Array:
    """Counts (2, N) int32 of trials and of failures per configuration.

    A trial counts when its episode ends; duplicates add up.

    Traced arrays (inside `jax.jit` and the like) have no values to check. There, an id outside [0, N) is
    dropped, and any `done` or `failed` other than 0 counts as true.

    Raises:
        InputError: the arrays do not broadcast, or ids are not integers. Where an episode is done and the
            values are known: an id is outside [0, N), or a `failed` is neither 0 nor 1.
    """
    config_id, done, failed = (jnp.ravel(jnp.asarray(part)) for part in check_outcomes(outcomes, num_configs))
    done = done.astype(bool)
    new = jnp.stack([done, done & failed.astype(bool)]).astype(jnp.int32)
    # Both at once: a third of the time of two segment sums.
    zero = jnp.zeros((2, num_configs), jnp.int32)
    counts = zero.at[:, config_id].add(new, mode="drop", wrap_negative_indices=False)
    return counts if axis_name is None else jax.lax.psum(counts, axis_name)


def by_config(
    outcomes: Outcomes,
    name: str,
    num_configs: int,
    reduction: Literal["sum", "max"] = "sum",
    axis_name: str | None = None,
) -> jax.Array:
    """Reduces one more field of the outcomes over each configuration's ended episodes, (N,) float32.

    Where none ended, the sum is 0 and the maximum is -inf.

    Raises:
        InputError: the outcomes lack the field, or it does not broadcast against `done`.
    """
    values = getattr(outcomes, name)
    if values is None:
        raise InputError(f"outcomes: {name} is None; the sampler needs it of every episode, and PPO gives it")
    ended = jnp.asarray(outcomes.done).astype(bool)
    try:
        shape = np.broadcast_shapes(*map(np.shape, (outcomes.config_id, ended, values)))
    except ValueError as error:
        raise InputError(f"outcomes: {name} {np.shape(values)} does not broadcast against done") from error
    reduce, nothing, over_devices = {
        "sum": (jax.ops.segment_sum, 0.0, jax.lax.psum),
        "max": (jax.ops.segment_max, -jnp.inf, jax.lax.pmax),
    }[reduction]
    counted = jnp.where(ended, jnp.asarray(values, jnp.float32), nothing)
    ids = jnp.broadcast_to(jnp.asarray(outcomes.config_id), shape)
    reduced = reduce(jnp.broadcast_to(jnp.asarray(counted), shape).ravel(), ids.ravel(), num_configs)
    return reduced if axis_name is None else over_devices(reduced, axis_name)


def check_outcomes(outcomes: Outcomes, num_configs: int) -> list[Any]:
    """The ids, `done` and `failed` of outcomes in one shape.

    Raises:
        InputError: as `count_outcomes` does.
    """
    config_id, done, failed = _broadcast(outcomes)
    _check_values(config_id, done, failed, num_configs)
    return [config_id, done, failed]


def _broadcast(outcomes: Outcomes) -> list[Any]:
    """The three parts in one shape; those with values to look at as NumPy arrays."""
    counted = outcomes[:3]
    parts = [_on_host(part) for part in counted]
    try:
        shape = np.broadcast_shapes(*map(np.shape, parts))
    except ValueError as error:
        shapes = ", ".join(
            f"{name} {np.shape(part)}" for name, part in zip(outcomes._fields, counted, strict=False)
        )
        raise InputError(f"outcomes: {shapes} do not broadcast; give arrays of one shape") from error
    return [(np if _has_values(part) else jnp).broadcast_to(part, shape) for part in parts]


def _on_host(part: Any) -> Any:
    is_hidden = isinstance(part, jax.core.Tracer) or (
        isinstance(part, jax.Array) and not part.is_fully_addressable  # partly another process's
    )
    return part if is_hidden else np.asarray(part)


def _has_values(part: Any) -> bool:
    return isinstance(part, np.ndarray)


def _check_values(config_id: Any, done: Any, failed: Any, num_configs: int) -> None:
    """Raises InputError for impossible ids and flags, as far as their values are known."""
    if not np.issubdtype(config_id.dtype, np.integer):
        raise InputError(
            f"outcomes: config_id is of type {config_id.dtype}; give integers from 0 to {num_configs - 1}"
        )
    counted = _truth("done", done, True) if _has_values(done) else None
    if counted is None:  # nobody knows which of the others count
        return
    if _has_values(config_id):
        outside = counted & ((config_id < 0) | (config_id >= num_configs))
        if outside.any():
            raise InputError(
                f"outcomes: config_id {config_id[outside][0]} does not exist; "
                f"the sampler has configurations 0 to {num_configs - 1}"
            )
    if _has_values(failed):
        _truth("failed", failed, counted)


def _truth(name: str, flags: np.ndarray, counted: np.ndarray | bool) -> np.ndarray:
    """Flags as bool, where those that count are 0 or 1."""
    wrong = counted & (flags != 0) & (flags != 1)
    if wrong.any():
        raise InputError(f"outcomes: {name} is {flags[wrong][0]}; give bool, or 0 and 1")
    return flags.astype(bool)
