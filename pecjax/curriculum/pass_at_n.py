"""Pass at n: prefers what may succeed within n tries but fails in the first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from pecjax.curriculum.base import Sampler, SamplerSettings
from pecjax.curriculum.memory import from_memory
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.posterior import beta_parameters, gain_of_retries


@dataclass(frozen=True)
class PassAtN(SamplerSettings):
    """Draws in proportion to u_n of the estimated chance of success (see `pass_at_n`).

    Attributes:
        tries: n, at least 1; 2 gives p (1 - p), and larger values approach the failure ratio.
        half_life: trials of a configuration that halve the weight of an earlier one.
    """

    tries: float = 8.0
    half_life: float = 10.0

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return pass_at_n(num_configs, self.tries, self.half_life)


def pass_at_n(num_configs: int, tries: Any = 8.0, half_life: Any = 10.0) -> Sampler:
    """Draws each configuration in proportion to u_n of its estimated chance of success.

        w_n = 1 - (1 - p)^tries - p,   p = (s_n + 1/2) / (s_n + f_n + 1)

    The successes s and failures f fade. One exponent leads from learnability to PEC's failure ratio, and
    what never succeeds loses its weight (u_N of linjiw/curriculum-maxrl).

    Raises:
        InputError: fewer than one configuration, or a number out of its range.
    """
    check_number("tries", tries, 1)

    def weight(memory: jax.Array, numbers: Numbers) -> jax.Array:
        a, b = beta_parameters(memory, 0.5)
        return gain_of_retries(a / (a + b), numbers["tries"])

    return from_memory(num_configs, {"tries": tries, "half_life": half_life}, weight)
