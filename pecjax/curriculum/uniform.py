"""Uniform: every configuration equally likely, the paper's baseline ("w/o PEC")."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.sampler import Outcomes, Sampler, choose
from pecjax.errors import InputError


class UniformState(NamedTuple):
    """Uniform sampling remembers nothing."""


def uniform(num_configs: int) -> Sampler:
    """Draws every configuration with probability 1 / N.

    Raises:
        InputError: fewer than one configuration.
    """
    if num_configs < 1:
        raise InputError(f"num_configs is {num_configs}; a sampler needs at least 1 configuration")

    def init() -> UniformState:
        return UniformState()

    def probabilities(state: UniformState) -> jax.Array:
        return jnp.full(num_configs, 1 / num_configs)

    def sample(state: UniformState, key: jax.Array, shape: tuple[int, ...] = ()) -> jax.Array:
        # As PEC draws: with one key, both begin a training with the same configurations.
        return choose(probabilities(state), key, shape)

    def update(state: UniformState, outcomes: Outcomes, axis_name: str | None = None) -> UniformState:
        return state

    return Sampler(init, probabilities, sample, update)
