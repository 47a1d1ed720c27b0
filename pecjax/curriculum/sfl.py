"""SFL: sampling for learnability; the scoring flights are trained on too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.ranking import best_share
from pecjax.curriculum.statistics import from_statistics


@dataclass(frozen=True)
class SFL(SamplerSettings):
    """Scores by uniform episodes, then draws much of the time from the most learnable (see `sfl`).

    Attributes:
        scoring: episodes that score, for each configuration.
        between: episodes until the next scoring, for each configuration.
        best: share of the table that counts as most learnable.
        mass: share of the draws that come from these until then; the others come from the whole table.
    """

    scoring: float = 4.0
    between: float = 8.0
    best: float = 0.1
    mass: float = 0.5

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return sfl(num_configs, self.scoring, self.between, self.best, self.mass)


class Scores(NamedTuple):
    """What the last scoring found, and how far things are.

    Attributes:
        counts: (2, N) int32, trials and failures of the scoring.
        top: (N,) float32, how draws from the most learnable are spread (see `ranking.best_share`).
        is_scoring: () bool.
        episodes: () int32, how many ended since scoring, or the time between, began.
    """

    counts: jax.Array
    top: jax.Array
    is_scoring: jax.Array
    episodes: jax.Array


def sfl(
    num_configs: int, scoring: Any = 4.0, between: Any = 8.0, best: Any = 0.1, mass: Any = 0.5
) -> Sampler:
    """Sampling for learnability (Rutherford et al. 2024), with every episode trained on and counted.

    Uniform draws score the table, `scoring` × N episodes long. Then a share `mass` of the draws comes evenly
    from the best × N configurations by p (1 - p) of their success in the scoring, the others from all,
    `between` × N episodes long, and it begins anew. The authors score with flights that are not trained on
    and not counted as steps.

    Raises:
        InputError: fewer than one configuration, or a number out of its range.
    """
    check_number("scoring", scoring, 0, above=True)
    check_number("between", between, 0, above=True)
    check_number("best", best, 0, 1, above=True)
    check_number("mass", mass, 0, 1)

    def begin() -> Scores:
        nothing = jnp.zeros((2, num_configs), jnp.int32)
        return Scores(nothing, jnp.zeros(num_configs), jnp.bool_(True), jnp.int32(0))

    def learn(now: Scores, new: jax.Array, numbers: Numbers) -> Scores:
        counts = jnp.where(now.is_scoring, now.counts + new, now.counts)
        episodes = now.episodes + new[0].sum()
        length = jnp.where(now.is_scoring, numbers["scoring"], numbers["between"]) * num_configs
        is_over = episodes >= length
        begins, ends = is_over & ~now.is_scoring, is_over & now.is_scoring
        top = jax.lax.cond(ends, lambda: best_share(_scores(counts), numbers["best"]), lambda: now.top)
        return Scores(
            jnp.where(begins, 0, counts),
            top,
            jnp.where(is_over, ~now.is_scoring, now.is_scoring),
            jnp.where(is_over, 0, episodes),
        )

    def weight(now: Scores, numbers: Numbers) -> jax.Array:
        of_best = numbers["mass"] * now.top + (1 - numbers["mass"]) / num_configs
        return jnp.where(now.is_scoring, 1 / num_configs, of_best)

    numbers = {"scoring": scoring, "between": between, "best": best, "mass": mass}
    return from_statistics(num_configs, numbers, begin, learn, weight)


def _scores(counts: jax.Array) -> jax.Array:
    """Learnability p (1 - p) (N,) of what was tried; what was not comes last."""
    trials, failures = counts[0].astype(jnp.float32), counts[1].astype(jnp.float32)
    score = failures * (trials - failures) / jnp.maximum(trials, 1) ** 2  # alike for p and 1 - p
    return jnp.where(trials > 0, score, -1.0)
