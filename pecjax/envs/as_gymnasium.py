"""Any task as an environment of Gymnasium."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import spaces

from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, World, num_configs, take_configs
from pecjax.errors import InputError

# Gymnasium's checker wants bounds that are finite.
MAX_FLOAT = float(np.finfo(np.float32).max)


class GymnasiumEnvironment(gymnasium.Env):
    """A task with its world under Gymnasium's contract, in NumPy arrays.

    `reset(options={"config_id": 3})` begins an episode in that configuration; without it, in one drawn
    uniformly. `info` says which, and a step's `success` and the task's metrics. Environments of one task
    object share their compiled programs.

    With `CurriculumWrapper` and `CurriculumVectorWrapper` the table is `{"config_id": np.arange(N)}`.
    """

    def __init__(self, task: Task, world: World) -> None:
        """The task and its world, as `TaskSettings.make` returns them."""
        self.task = task
        self.world = world
        self.observation_space = _space(task.observation_space)
        self.action_space = _space(task.action_space)
        self.metadata = {"render_modes": []}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode.

        Raises:
            InputError: options other than `config_id`, or a configuration that does not exist.
        """
        super().reset(seed=seed)
        number = num_configs(self.world.table)
        drawn = int(
            self.np_random.integers(number)
        )  # in any case: what follows does not depend on the options
        config_id = _config_id(options or {}, number, drawn)
        config = take_configs(self.world.table, config_id)
        self._key = jax.random.key(self.np_random.integers(2**32))
        self._state, observation = _reset(self.task, self._key, config, self.world.params)
        self._told = {"config_id": config_id}
        self._length = 0
        return _on_host(observation, self.observation_space), dict(self._told)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One action. What follows an ending is undefined: reset."""
        self._length += 1
        action = np.asarray(action, np.int32 if isinstance(self.task.action_space, Discrete) else np.float32)
        after, observation = _step(self.task, self._key, self._length, self._state, action, self.world.params)
        self._state = after.state
        after, observation = jax.device_get((after._replace(state=None), observation))
        told = {"success": bool(after.success)} | {name: x.item() for name, x in after.metrics.items()}
        return (
            _on_host(observation, self.observation_space),
            float(after.reward),
            bool(after.terminated),
            bool(after.truncated),
            self._told | told,
        )


@partial(jax.jit, static_argnums=0)
def _reset(task: Task, key: jax.Array, config: Any, params: Any) -> tuple[Any, Any]:
    key_reset, key_observe = jax.random.split(jax.random.fold_in(key, 0))
    state = task.reset(key_reset, config, params)
    return state, task.observe(key_observe, state, params)


@partial(jax.jit, static_argnums=0)
def _step(task: Task, key: jax.Array, length: int, state: Any, action: Any, params: Any) -> tuple[Any, Any]:
    key_step, key_observe = jax.random.split(jax.random.fold_in(key, length))
    after = task.step(key_step, state, action, params)
    return after, task.observe(key_observe, after.state, params)


def _config_id(options: dict[str, Any], number: int, drawn: int) -> int:
    if unknown := set(options) - {"config_id"}:
        raise InputError(
            f"reset: options has {', '.join(sorted(unknown))}; it takes config_id and nothing else"
        )
    config_id = int(options.get("config_id", drawn))
    if not 0 <= config_id < number:
        raise InputError(f"reset: config_id {config_id} does not exist; there are 0 to {number - 1}")
    return config_id


def _on_host(observation: Any, space: spaces.Space) -> Any:
    """An observation in NumPy arrays, as the space nests them."""
    if isinstance(space, spaces.Dict):
        return {name: _on_host(observation[name], part) for name, part in space.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(_on_host(*both) for both in zip(observation, space, strict=True))
    return np.asarray(observation)


def _space(space: Any) -> Any:
    """The same space as Gymnasium has it."""
    if isinstance(space, Discrete):
        return spaces.Discrete(space.num_actions)
    if isinstance(space, Box):
        return spaces.Box(max(space.low, -MAX_FLOAT), min(space.high, MAX_FLOAT), space.shape, np.float32)
    if isinstance(space, dict):
        return spaces.Dict({name: _space(part) for name, part in space.items()})
    return spaces.Tuple([_space(part) for part in space])
