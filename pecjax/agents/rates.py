"""Learning rates that fall."""

from __future__ import annotations

import optax


def falling_rate(rate: float, decay_steps: int | None, updates_per_step: float) -> optax.ScalarOrSchedule:
    """A rate that falls linearly to a tenth, where it stays, or a constant one.

    Args:
        decay_steps: environment steps over which it falls; None for a constant rate.
        updates_per_step: the optimizer's updates for each environment step.
    """
    if decay_steps is None:
        return rate
    return optax.linear_schedule(rate, 0.1 * rate, max(1, round(decay_steps * updates_per_step)))
