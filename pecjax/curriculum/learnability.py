"""Learnability: prefers what neither always fails nor always succeeds, by a posterior of its success."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.memory import from_memory
from pecjax.curriculum.numbers import Numbers
from pecjax.curriculum.posterior import beta_parameters


@dataclass(frozen=True)
class Learnability(SamplerSettings):
    """Draws in proportion to the expected p (1 - p) of the chance of success p (see `learnability`).

    Attributes:
        half_life: trials of a configuration that halve the weight of an earlier one.
    """

    half_life: float = 3.0

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return learnability(num_configs, self.half_life)


def learnability(num_configs: int, half_life: Any = 3.0) -> Sampler:
    """Draws each configuration in proportion to the expectation of p (1 - p).

        w_n = E[p (1 - p)] = a b / ((a + b) (a + b + 1)),   p ~ Beta(a, b) = Beta(s_n + 1, f_n + 1)

    The successes s and failures f fade. The score is that of SFL (Rutherford et al. 2024) and of Tzannetos
    et al. (2023); the posterior replaces flights that are only for scoring.

    Raises:
        InputError: fewer than one configuration, or a half-life that is not above 0.
    """

    def weight(memory: jax.Array, numbers: Numbers) -> jax.Array:
        a, b = beta_parameters(memory, 1.0)
        return a * b / ((a + b) * (a + b + 1))

    return from_memory(num_configs, {"half_life": half_life}, weight)
