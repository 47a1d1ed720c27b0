"""Thompson sampling: learnability of a chance of success that is drawn from its posterior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler, SamplerSettings, check_outcomes, count_outcomes
from pecjax.curriculum.memory import begin_memory, remember
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.posterior import beta_draws, beta_parameters
from pecjax.curriculum.statistics import from_statistics, ids_in_batch, learn_alone

AT_ONCE = 65_536  # chances of success that are drawn after a batch


@dataclass(frozen=True)
class Thompson(SamplerSettings):
    """Draws in proportion to p (1 - p) of a chance of success p drawn anew after each batch (see `thompson`).

    Attributes:
        half_life: trials of a configuration that halve the weight of an earlier one.
    """

    half_life: float = 10.0

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return thompson(num_configs, self.half_life)


class Believed(NamedTuple):
    """What it knows, what it has drawn, and where it is in its stream of random numbers.

    Attributes:
        memory: (2, N) successes and failures that fade.
        drawn: (N,) chances of success, as drawn last; 1/2 until then.
        turn: () int32, where in the table the next ones are drawn.
        key: (2,) uint32, of the next draw. It moves on with the outcomes, so that runs of other seeds draw
            otherwise, and the state says all.
    """

    memory: jax.Array
    drawn: jax.Array
    turn: jax.Array
    key: jax.Array


class Heard(NamedTuple):
    """A batch.

    Attributes:
        counts: (2, N) int32, trials and failures.
        ids: as `ids_in_batch` has them.
        sums: (2,) uint32, of n + 1 over the trials and over the failures of each configuration n.
    """

    counts: jax.Array
    ids: jax.Array | None
    sums: jax.Array


def thompson(num_configs: int, half_life: Any = 10.0) -> Sampler:
    """Draws each configuration in proportion to p (1 - p) of a p that is drawn from its posterior.

        w_n = p_n (1 - p_n),   p_n ~ Beta(s_n + 1, f_n + 1)

    The p are drawn again after each batch that has an outcome, and successes s and failures f fade. So what
    is little known is tried sooner or later (as in MoPPS, Qu et al. 2025). The draws are nearly those of
    the posterior (`posterior.beta_draws`). In a table of more than `AT_ONCE` configurations, that many are
    drawn again after each batch, in turn.

    Raises:
        InputError: fewer than one configuration, or a half-life that is not above 0.
    """
    check_number("half_life", half_life, 0, above=True)
    at_once = min(num_configs, AT_ONCE)

    def begin() -> Believed:
        key = jax.random.key_data(jax.random.key(0, impl="threefry2x32"))
        return Believed(begin_memory(num_configs), jnp.full(num_configs, 0.5), jnp.int32(0), key)

    def hear(outcomes: Outcomes, number: int, axis_name: str | None) -> Heard:
        config_id, done, failed = map(jnp.asarray, check_outcomes(outcomes, number))
        done = done.astype(bool)
        places = jnp.where((config_id >= 0) & (config_id < number), config_id + 1, 0).astype(jnp.uint32)
        sums = jnp.stack([(places * flags).sum() for flags in (done, done & failed.astype(bool))])
        return Heard(
            count_outcomes(outcomes, number, axis_name),
            ids_in_batch(outcomes, number, axis_name),
            sums if axis_name is None else jax.lax.psum(sums, axis_name),
        )

    def learn(known: Believed, heard: Heard, numbers: Numbers) -> Believed:
        memory = learn_alone(
            lambda before, new: remember(before, new, numbers["half_life"]),
            known.memory, heard.counts, heard.ids,
        )  # fmt: skip
        key = jax.random.wrap_key_data(known.key, impl="threefry2x32")
        for number in heard.sums:
            key = jax.random.fold_in(key, number)
        those = jnp.minimum(known.turn * at_once, num_configs - at_once) + jnp.arange(at_once)
        p = beta_draws(key, *beta_parameters(memory[:, those], 1.0))
        turn = (known.turn + 1) % -(-num_configs // at_once)
        learned = heard.counts[0].any()
        return Believed(
            memory,
            known.drawn.at[those].set(jnp.where(learned, p, known.drawn[those])),
            jnp.where(learned, turn, known.turn),
            jnp.where(learned, jax.random.key_data(key), known.key),
        )

    return from_statistics(
        num_configs,
        {"half_life": half_life},
        begin,
        learn,
        weight=lambda known, _: known.drawn * (1 - known.drawn),
        hear=hear,
    )
