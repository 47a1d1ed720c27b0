"""Failure EMA: a moving average of each configuration's failures, to a power."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.memory import average
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.statistics import from_statistics


@dataclass(frozen=True)
class FailureEMA(SamplerSettings):
    """Draws in proportion to a power of a moving average of failures (see `failure_ema`).

    Attributes:
        half_life: trials of a configuration that halve the weight of its past.
        power: exponent of the average; the larger, the more the hardest are preferred.
    """

    half_life: float = 10.0
    power: float = 2.0

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return failure_ema(num_configs, self.half_life, self.power)


def failure_ema(num_configs: int, half_life: Any = 10.0, power: Any = 2.0) -> Sampler:
    """Draws each configuration in proportion to a power of the moving average of its failures.

        e_n <- γ e_n + (1 - γ) failed   at each trial, from e_n = 1;   w_n = e_n ^ power

    Here γ = 2^(-1 / half-life). BeyondMimic (Liao et al. 2025) averages failure counts, which feeds on
    itself; an average of ratios does not.

    Raises:
        InputError: fewer than one configuration, or a number out of its range.
    """
    check_number("half_life", half_life, 0, above=True, finite=True)
    check_number("power", power, 0, finite=True)

    def weight(failure: jax.Array, numbers: Numbers) -> jax.Array:
        return jnp.exp(numbers["power"] * jnp.log(jnp.maximum(failure, 1e-30)))  # several times as fast as **

    return from_statistics(
        num_configs,
        {"half_life": half_life, "power": power},
        begin=lambda: jnp.ones(num_configs, jnp.float32),
        learn=lambda before, counts, numbers: average(before, counts, numbers["half_life"]),
        weight=weight,
        each_alone=True,
    )
