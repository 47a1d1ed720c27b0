"""Limits on a run's settings, which may come from a stranger's config.json."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

from pecjax import settings_tree
from pecjax.errors import InputError

MAX_EPISODES = 100_000  # of one evaluation: each keeps its whole path
MAX_INT = 2**31 - 1  # what a device's integers hold
MOST = {
    "num_envs": 2**20,
    "num_steps": 2**20,
    "num_epochs": 10_000,
    "num_minibatches": 2**20,
    "num_actors": 2**20,
    "num_shards": 2**12,
    "rollout_length": 2**16,
    "n_step": 2**12,
    "batch_size": 2**24,
    "capacity": 2**36,  # more than memory holds, which `devices.check_memory` knows
    "hidden": 2**14,
    "trunk": 2**14,
    "head": 2**14,
    "memory_size": 2**14,
    "memory_stride": 2**14,
    "episodes": MAX_EPISODES,
    "max_steps": 10**6,
}
MAX_LAYERS = 32
MAX_BATCH = 2**28  # steps that all environments take in an iteration


def check_limits(settings: Any) -> None:
    """Makes sure that no number of a RunSettings is beyond what any run needs.

    What the machine's memory holds is another matter (see `devices.check_memory`).

    Raises:
        InputError: the first number that is.
    """
    for name, value in _numbers(settings):
        most = MOST.get(name, MAX_INT) if isinstance(value, int) else sys.float_info.max
        if not abs(value) <= most:
            most = f"{most:,} is the most" if isinstance(value, int) else "it must be finite"
            raise InputError(f"{name.replace('_', '-')} is {str(value)[:30]}; {most}")
    for path, layers in settings_tree.leaves(settings.agent):
        name = path.rpartition(".")[2]
        if name == "head" and not layers >= 1:
            raise InputError(f"head is {layers} wide; give at least 1")
        if name not in ("hidden", "trunk") or not isinstance(layers, tuple):
            continue
        least = 1 if name == "hidden" else 0
        if not least <= len(layers) <= MAX_LAYERS or any(width < 1 for width in layers):
            raise InputError(
                f"{name} has {len(layers)} layers, {str(layers)[:60]} wide; give {least} to {MAX_LAYERS}, "
                "each at least 1 wide"
            )
    agent = settings.agent
    if agent.num_envs * agent.num_steps > MAX_BATCH:
        raise InputError(
            f"{agent.num_envs:,} environments of {agent.num_steps:,} steps are more than "
            f"{MAX_BATCH:,} steps an iteration; use fewer of either"
        )


def _numbers(settings: Any) -> Iterator[tuple[str, int | float]]:
    """Every number of a tree of settings with its field's name."""
    for path, value in settings_tree.leaves(settings):
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, int | float):
                yield path.rpartition(".")[2], number
