"""Samplers within samplers: the numbers of the inner one, dotted by its name, and its size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax

from pecjax.curriculum.base import Sampler


def inner_numbers(name: str, changes: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The changes that are of the inner sampler of that name, by their own names, and the others."""
    start = f"{name}."
    inner = {key.removeprefix(start): value for key, value in changes.items() if key.startswith(start)}
    return inner, {key: value for key, value in changes.items() if not key.startswith(start)}


def num_configs_of(sampler: Sampler) -> int:
    """N, the number of configurations that a sampler draws from."""
    return jax.eval_shape(lambda: sampler.probabilities(sampler.init())).shape[0]
