"""Table top: most draws from the best few of the table, the rest from all of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.memory import from_memory
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.posterior import beta_parameters, gain_of_retries
from pecjax.curriculum.ranking import best_share


@dataclass(frozen=True)
class TableTop(SamplerSettings):
    """Draws evenly from the best of the table by u_n, and sometimes from all (see `table_top`).

    Attributes:
        tries: n of u_n, at least 1.
        half_life: trials of a configuration that halve the weight of an earlier one.
        best: share of the table that counts as its top.
        mass: share of the draws that come from the top; the others come from the whole table.
    """

    tries: float = 8.0
    half_life: float = 10.0
    best: float = 0.1
    mass: float = 0.75

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return table_top(num_configs, self.tries, self.half_life, self.best, self.mass)


def table_top(
    num_configs: int, tries: Any = 8.0, half_life: Any = 10.0, best: Any = 0.1, mass: Any = 0.75
) -> Sampler:
    """Draws a share of the episodes evenly from the best configurations, and the others from all.

        P_n = mass * top_n / (best * N) + (1 - mass) / N

    Here top_n is 1 for the best * N configurations by u_n (see `pass_at_n`), 0 for the others, and the same
    fraction for all at the threshold (`ranking.best_share`). This is the buffer of SFL (Rutherford et al.
    2024) without flights that are only for scoring.

    Raises:
        InputError: fewer than one configuration, or a number out of its range.
    """
    check_number("tries", tries, 1)
    check_number("best", best, 0, 1, above=True)
    check_number("mass", mass, 0, 1)

    def weight(memory: jax.Array, numbers: Numbers) -> jax.Array:
        a, b = beta_parameters(memory, 0.5)
        top = best_share(gain_of_retries(a / (a + b), numbers["tries"]), numbers["best"])
        return numbers["mass"] * top + (1 - numbers["mass"]) / num_configs

    return from_memory(
        num_configs, {"tries": tries, "half_life": half_life, "best": best, "mass": mass}, weight
    )
