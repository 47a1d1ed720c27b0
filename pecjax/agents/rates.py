"""Learning rates that fall."""

from __future__ import annotations

import optax

from pecjax.errors import InputError


def check_decay(decay_steps: int | None) -> None:
    """Raises InputError where a rate falls over less than a step."""
    if decay_steps is not None and decay_steps < 1:
        raise InputError(f"decay-steps is {decay_steps}; give 1 or more, or none")


def falling_rate(rate: float, decay_steps: int | None, updates_per_step: float) -> optax.ScalarOrSchedule:
    """A rate that falls linearly to a tenth, where it stays, or a constant one.

    Args:
        decay_steps: environment steps over which it falls; None for a constant rate.
        updates_per_step: the optimizer's updates for each environment step.
    """
    if decay_steps is None:
        return rate
    return optax.linear_schedule(rate, 0.1 * rate, max(1, round(decay_steps * updates_per_step)))
