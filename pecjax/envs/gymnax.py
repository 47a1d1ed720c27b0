"""Environments of gymnax, unmodified, as tasks: rows of their `EnvParams` are the configurations."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, Transition
from pecjax.errors import InputError

# (terminated, truncated, reward) of a step -> whether the episode, should it end here, has succeeded
Success = Callable[[jax.Array, jax.Array, jax.Array], jax.Array]


def survived(terminated: jax.Array, truncated: jax.Array, reward: jax.Array) -> jax.Array:
    """Success where the aim is to last for as long as there is time, as CartPole's is."""
    return truncated & ~terminated


def params_table(params: Any, **values: Any) -> Any:
    """A table of `EnvParams`: some of their fields vary, the others are as in `params`.

    Example:
        table = params_table(env.default_params, length=np.linspace(0.2, 2.0, 50))

    Args:
        values: (N,) each.

    Raises:
        InputError: no such field, or arrays of several lengths.
    """
    fields = [field.name for field in dataclasses.fields(params)]
    if unknown := [name for name in values if name not in fields]:
        raise InputError(f"no parameter {unknown[0]}; there are {', '.join(fields)}")
    sizes = {np.shape(value) for value in values.values()}
    if len(sizes) != 1 or len(next(iter(sizes))) != 1:
        raise InputError(f"parameters have shapes {sorted(sizes)}; give arrays of one length")
    (size,) = sizes.pop()
    rows = {name: np.asarray(values.get(name, np.full(size, getattr(params, name)))) for name in fields}
    kept = {name: row.astype(np.float32 if row.dtype.kind == "f" else np.int32) for name, row in rows.items()}
    return type(params)(**kept)


class GymnaxState(NamedTuple):
    """An episode.

    Attributes:
        state: the environment's own.
        obs: what it has shown last.
        config: the episode's `EnvParams`.
    """

    state: Any
    obs: Any
    config: Any


class GymnaxTask(Task):
    """An environment of gymnax 1.0 or later; `World.params` are not used."""

    def __init__(self, env: Any, params: Any, success: Success) -> None:
        """Wraps `env`.

        Args:
            params: whose spaces and greatest number of steps are those of all configurations.
            success: see `survived`.
        """
        self._env = env
        self._success = success
        space, actions = env.observation_space(params), env.action_space(params)
        if not hasattr(actions, "n") and (np.ptp(actions.low) or np.ptp(actions.high)):
            raise InputError(
                f"the bounds of actions are {actions.low} and {actions.high}; all numbers of an action must "
                "have the same, wrap the environment so that they do"
            )
        # Observations go to networks as they are: bounds of 10³⁸ say nothing about their scale.
        self.observation_space = Box(tuple(space.shape))
        self.action_space = (
            Discrete(int(actions.n))
            if hasattr(actions, "n")
            else Box(tuple(actions.shape), float(np.min(actions.low)), float(np.max(actions.high)))
        )
        self.max_steps = int(params.max_steps_in_episode)
        self.truncates = True

    def reset(self, key: jax.Array, config: Any, params: Any) -> GymnaxState:
        """The environment's first state under these `EnvParams`."""
        obs, state = self._env.reset_env(key, config)
        return GymnaxState(jax.tree.map(jnp.asarray, state), obs, config)

    def step(self, key: jax.Array, state: GymnaxState, action: jax.Array, params: Any) -> Transition:
        """One step of the environment, without its automatic reset."""
        obs, after, reward, terminated, _ = self._env.step_env(key, state.state, action, state.config)
        truncated = self._env.is_truncated(after, state.config)
        reward = jnp.asarray(reward, jnp.float32)
        success = self._success(terminated, truncated, reward)
        return Transition(GymnaxState(after, obs, state.config), reward, terminated, truncated, success, {})

    def observe(self, key: jax.Array, state: GymnaxState, params: Any) -> jax.Array:
        """What the environment has shown last."""
        return jnp.asarray(state.obs, jnp.float32)
