"""Learning progress: prefers configurations whose success changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.memory import fading
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.statistics import from_statistics

UNTRIED = -1.0  # in place of an average
THETA = 0.1  # how much changes of rare successes are magnified


@dataclass(frozen=True)
class LearningProgress(SamplerSettings):
    """Draws each configuration by how much its success has changed lately (see `learning_progress`).

    Attributes:
        fast, slow: half-lives of the averages in trials of a configuration.
    """

    fast: float = 5.0
    slow: float = 25.0

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return learning_progress(num_configs, self.fast, self.slow)


def learning_progress(num_configs: int, fast: Any = 5.0, slow: Any = 25.0) -> Sampler:
    """Draws each configuration by how much its success has changed lately, up or down.

        l_n = |r(p_fast) - r(p_slow)|,   r(p) = p (1 - θ) / (p + θ (1 - 2 p)),   θ = 0.1
        w_n = sigmoid((l_n - mean l) / std l)   if it was ever tried, else 1

    Here p_fast and p_slow are two moving averages of success that begin with the first trials' ratio. Mean
    and standard deviation are over what was tried (Kanitscheider et al. 2021, "Multi-task curriculum
    learning in a complex, visual, hard-exploration domain"; the sigmoid as in Syllabus, Sullivan et al.
    2024). No weight is ever 0.

    Raises:
        InputError: fewer than one configuration, or a half-life that is not above 0.
    """
    check_number("fast", fast, 0, above=True, finite=True)
    check_number("slow", slow, 0, above=True, finite=True)

    def learn(averages: jax.Array, counts: jax.Array, numbers: Numbers) -> jax.Array:
        trials = counts[0].astype(jnp.float32)
        success = (trials - counts[1]) / jnp.maximum(trials, 1.0)
        kept = jnp.stack([fading(trials, numbers[name])[0] for name in ("fast", "slow")])
        later = kept * averages + (1 - kept) * success
        return jnp.where(trials > 0, jnp.where(averages == UNTRIED, success, later), averages)

    def weight(averages: jax.Array, numbers: Numbers) -> jax.Array:
        tried = averages[0] != UNTRIED
        fast, slow = _magnified(averages)
        progress = jnp.where(tried, jnp.abs(fast - slow), 0.0)
        number = jnp.maximum(tried.sum(), 1)
        far = jnp.where(tried, progress - progress.sum() / number, 0.0)
        deviation = jnp.sqrt((far * far).sum() / number)
        return jnp.where(tried, jax.nn.sigmoid(far / jnp.maximum(deviation, 1e-6)), 1.0)

    return from_statistics(
        num_configs,
        {"fast": fast, "slow": slow},
        begin=lambda: jnp.full((2, num_configs), UNTRIED, jnp.float32),
        learn=learn,
        weight=weight,
        each_alone=True,
    )


def _magnified(p: jax.Array) -> jax.Array:
    """r(p), from 0 to 1 like p, steep near 0."""
    return p * (1 - THETA) / (p + THETA * (1 - 2 * p))
