"""DRO: probabilities that climb towards the highest scores, held back by their entropy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.memory import average
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.simplex import project
from pecjax.curriculum.statistics import from_statistics

FLOOR = 0.01  # of the uniform share, that every configuration keeps


@dataclass(frozen=True)
class DRO(SamplerSettings):
    """Climbs the gradient of the expected failure ratio on the simplex (see `dro`).

    Attributes:
        step: of the ascent, in uniform shares.
        entropy: weight of the entropy that holds it back; with 0 it goes to the single worst.
        half_life: trials of a configuration that halve the weight of its past failures.
    """

    step: float = 0.05
    entropy: float = 0.05
    half_life: float = 10.0

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return dro(num_configs, self.step, self.entropy, self.half_life)


class Climber(NamedTuple):
    """Where it stands, and the slope that it sees.

    Attributes:
        position: (N,) probabilities.
        failure: (N,) moving averages of failures, 1 where nobody has tried.
    """

    position: jax.Array
    failure: jax.Array


def dro(num_configs: int, step: Any = 0.05, entropy: Any = 0.05, half_life: Any = 10.0) -> Sampler:
    """Probabilities y by projected gradient ascent, a step after each batch that has an outcome.

        y <- project(y + step / N * ∇_y (y · e - entropy * Σ y log(N y)))

    The e are moving averages of failures, and `project` goes to the simplex whose every part is at least
    0.01 / N. So the distribution moves towards the one under which the learner fails most (distributionally
    robust optimization). Sagawa et al. 2020 climb by exponents, NCC (Monette et al. 2025) by this rule.
    Steps are in uniform shares, and the entropy is relative to the uniform distribution, so neither depends
    on N.

    Raises:
        InputError: fewer than one configuration, or a number out of its range.
    """
    check_number("step", step, 0, finite=True)
    check_number("entropy", entropy, 0, finite=True)
    check_number("half_life", half_life, 0, above=True, finite=True)

    def begin() -> Climber:
        return Climber(
            jnp.full(num_configs, 1 / num_configs, jnp.float32), jnp.ones(num_configs, jnp.float32)
        )

    def learn(before: Climber, counts: jax.Array, numbers: Numbers) -> Climber:
        failure = average(before.failure, counts, numbers["half_life"])
        slope = failure - numbers["entropy"] * (jnp.log(num_configs * before.position) + 1)
        climbed = project(before.position + numbers["step"] / num_configs * slope, FLOOR / num_configs)
        return Climber(jnp.where(counts[0].sum() > 0, climbed, before.position), failure)

    return from_statistics(
        num_configs,
        {"step": step, "entropy": entropy, "half_life": half_life},
        begin,
        learn,
        weight=lambda now, numbers: now.position,
    )
