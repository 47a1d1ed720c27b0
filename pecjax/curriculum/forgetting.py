"""Forgetting: PEC with counts that fade, so recent trials decide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.memory import from_memory
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.pec import MAX_ALPHA


@dataclass(frozen=True)
class Forgetting(SamplerSettings):
    """Draws as PEC does, by successes and failures that fade (see `forgetting`).

    Attributes:
        alpha: α from 0 to `MAX_ALPHA`; the larger, the nearer to uniform.
        half_life: trials of a configuration that halve the weight of an earlier one.
    """

    alpha: float = 0.2
    half_life: float = 20.0

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return forgetting(num_configs, self.alpha, self.half_life)


def forgetting(num_configs: int, alpha: Any = 0.2, half_life: Any = 20.0) -> Sampler:
    """Draws each configuration with probability proportional to its recent failure ratio plus α.

        w_n = f_n / (s_n + f_n) + α   if it was ever tried, else 1

    The successes s and failures f fade: each later trial of the configuration makes earlier ones count
    less. With a half-life of infinity it is PEC.

    Raises:
        InputError: fewer than one configuration, or a number out of its range.
    """
    check_number("alpha", alpha, 0, MAX_ALPHA)

    def weight(memory: jax.Array, numbers: Numbers) -> jax.Array:
        known = memory.sum(axis=0)
        ratio = memory[1] / jnp.where(known > 0, known, 1.0)
        return jnp.where(known > 0, ratio + numbers["alpha"], 1.0)

    return from_memory(num_configs, {"alpha": alpha, "half_life": half_life}, weight)
