"""PEC: prioritized environment configuration (Jang & Choi 2022, Eq. 1-2 and Fig. 1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.curriculum.base import Outcomes, Sampler, check_num_configs, count_outcomes
from pecjax.curriculum.draws import sample_ids
from pecjax.errors import InputError

MAX_ALPHA = 1e6  # where float32 no longer tells it from uniform sampling


class PECState(NamedTuple):
    """All that PEC remembers.

    Attributes:
        counts: (2, N) int32, trials and failures over the whole training.
        alpha: () float32, kept here so that a study over α is a `vmap`.
    """

    counts: jax.Array
    alpha: jax.Array


def pec(num_configs: int, alpha: float | jax.Array = 0.2) -> Sampler:
    """Draws each configuration with probability proportional to its failure ratio plus α.

        p_n = f_n / t_n + α   if t_n > 0, else 1        (Eq. 1)
        P_n = p_n / Σ p                                 (Eq. 2)

    Where every priority is 0 (α = 0 and nothing fails any more) it draws uniformly.

    Example:
        sampler = pec(num_configs=20, alpha=0.2)
        state = sampler.init()
        ids = sampler.sample(state, jax.random.key(0), shape=512)
        state = sampler.update(state, Outcomes(ids, done, failed))

    Args:
        num_configs: N, at least 1.
        alpha: α from 0 to `MAX_ALPHA`, a scalar (several by `vmap`): the larger, the nearer to uniform.

    Raises:
        InputError: fewer than one configuration, or α out of its range or NaN.
    """
    check_num_configs(num_configs)
    if np.ndim(alpha):
        raise InputError(f"alpha has shape {np.shape(alpha)}; give one number, and vmap over several")
    if not isinstance(alpha, jax.core.Tracer) and not 0 <= alpha <= MAX_ALPHA:
        raise InputError(f"alpha is {alpha}; it must be a number from 0 to {MAX_ALPHA:g}")

    def init() -> PECState:
        return PECState(jnp.zeros((2, num_configs), jnp.int32), jnp.asarray(alpha, jnp.float32))

    def probabilities(state: PECState) -> jax.Array:
        trials, failures = state.counts[0], state.counts[1]
        priority = jnp.where(trials > 0, failures / jnp.maximum(trials, 1) + state.alpha, 1.0)
        total = priority.sum()
        return jnp.where(total > 0, priority / jnp.where(total > 0, total, 1.0), 1 / num_configs)

    def sample(state: PECState, key: jax.Array, shape: int | Sequence[int] = ()) -> jax.Array:
        return sample_ids(probabilities(state), key, shape)

    def update(state: PECState, outcomes: Outcomes, axis_name: str | None = None) -> PECState:
        return state._replace(counts=state.counts + count_outcomes(outcomes, num_configs, axis_name))

    return Sampler(init, probabilities, sample, update)
