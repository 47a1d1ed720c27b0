"""The rooms as Brax's PPO wants them: flat observations, continuous actions, snapped."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import Env, State

import pecjax
from pecjax.agents.observations import encode
from pecjax.envs.rooms.sensing import scale
from pecjax.envs.rooms.task import SPEEDS, YAW_RATES


def flat(env: pecjax.RoomsNavigation, obs: dict[str, jax.Array]) -> jax.Array:
    """An observation as our own networks are given it."""
    return encode(env.task.observation_space, scale(obs, env.scene.vehicle.camera.far))


def snapped(action: jax.Array) -> jax.Array:
    """The action nearest to two numbers from -1 to 1."""
    part = (jnp.clip(action, -1, 1) + 1) / 2 * jnp.array([len(SPEEDS), len(YAW_RATES)])
    speed, turn = jnp.floor(jnp.minimum(part, jnp.array([len(SPEEDS), len(YAW_RATES)]) - 1e-3))
    return (speed * len(YAW_RATES) + turn).astype(jnp.int32)


class BraxRooms(Env):
    """Our environment as Brax's PPO wants it: flat observations, continuous actions snapped."""

    def __init__(self, env: pecjax.RoomsNavigation) -> None:
        self.inner = env

    def _flat(self, state: State) -> State:
        return state.replace(obs=flat(self.inner, state.obs))

    def reset(self, rng: jax.Array) -> State:
        return self._flat(self.inner.reset(rng))

    def step(self, state: State, action: jax.Array) -> State:
        state = self._flat(self.inner.step(state, snapped(action)))
        return state.replace(reward=state.reward * 1e-3)

    @property
    def observation_size(self) -> int:
        return int(np.prod(self.inner.observation_size["depth"])) + 3

    @property
    def action_size(self) -> int:
        return 2

    @property
    def backend(self) -> str:
        return "mjx"
