"""PEC: prioritized environment configuration (Jang & Choi 2022, Eq. 1-2 and Fig. 1)."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.counts import from_counts
from pecjax.curriculum.numbers import check_number

MAX_ALPHA = 1e6  # where float32 no longer tells it from uniform sampling


@dataclass(frozen=True)
class PEC(SamplerSettings):
    """Draws each configuration with probability proportional to its failure ratio plus α (see `pec`).

    Attributes:
        alpha: α from 0 to `MAX_ALPHA`; the larger, the nearer to uniform.
    """

    alpha: float = 0.2

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return pec(num_configs, self.alpha)


def pec(num_configs: int, alpha: float | jax.Array = 0.2) -> Sampler:
    """Draws each configuration with probability proportional to its failure ratio plus α.

        p_n = f_n / t_n + α   if t_n > 0, else 1        (Eq. 1)
        P_n = p_n / Σ p                                 (Eq. 2)

    Where every priority is 0 (α = 0 and nothing fails any more), draws are uniform.

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
    check_number("alpha", alpha, 0, MAX_ALPHA)

    def priority(trials: jax.Array, failures: jax.Array, numbers: dict[str, jax.Array]) -> jax.Array:
        return jnp.where(trials > 0, failures / jnp.maximum(trials, 1) + numbers["alpha"], 1.0)

    return from_counts(num_configs, {"alpha": alpha}, priority)
