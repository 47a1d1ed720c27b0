"""Any task as an environment of gymnax."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnax.environments import environment, spaces  # pyright: ignore[reportMissingImports]

from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, World, num_configs, take_configs


@struct.dataclass
class TaskParams(environment.EnvParams):
    """One configuration; with a leading axis N, a table of them.

    Attributes:
        max_steps_in_episode: int, where an episode is cut off; the task's own limit holds too.
        config: a row of the world's table.
    """

    max_steps_in_episode: Any = 1
    config: Any = None


class TaskState(NamedTuple):
    """An episode.

    Attributes:
        state: the task's own.
        time: () int32, actions so far.
        terminated: () bool, as the task says it; so too the next.
        truncated: () bool.
    """

    state: Any
    time: jax.Array
    terminated: jax.Array
    truncated: jax.Array


class GymnaxEnvironment(environment.Environment):
    """A task with its world under the contract of gymnax 1.0 or later.

    The params are an episode's configuration; `Curriculum` draws them:

        env = GymnaxEnvironment(*settings.make())
        params = CurriculumParams(env.table, sampler.probabilities(state))
        env = Curriculum(env)

    `info` has `success`, and the task's metrics.
    """

    def __init__(self, task: Task, world: World) -> None:
        """The world's `params` are constants of the compiled programs."""
        self.task = task
        self.world = world

    @property
    def table(self) -> TaskParams:
        """All configurations of the world: `TaskParams` with a leading axis N."""
        limits = np.full(num_configs(self.world.table), self.task.max_steps, np.int32)
        return TaskParams(limits, self.world.table)

    @property
    def default_params(self) -> TaskParams:
        """The first configuration."""
        return take_configs(self.table, 0)

    def reset_env(self, key: jax.Array, params: TaskParams) -> tuple[Any, TaskState]:
        """The first observation and state of an episode in this configuration."""
        key_reset, key_observe = jax.random.split(key)
        config = jax.tree.map(jnp.asarray, params.config)
        state = self.task.reset(key_reset, config, self.world.params)
        never = jnp.zeros((), bool)
        obs = self.task.observe(key_observe, state, self.world.params)
        return obs, TaskState(state, jnp.zeros((), jnp.int32), never, never)

    def step_env(
        self, key: jax.Array, state: TaskState, action: Any, params: TaskParams
    ) -> tuple[Any, TaskState, jax.Array, jax.Array, dict[Any, Any]]:
        """One action, without the automatic reset."""
        key_step, key_observe = jax.random.split(key)
        after = self.task.step(key_step, state.state, action, self.world.params)
        obs = self.task.observe(key_observe, after.state, self.world.params)
        state = TaskState(after.state, state.time + 1, after.terminated, after.truncated)
        return obs, state, after.reward, after.terminated, {"success": after.success, **after.metrics}

    def observe(self, key: jax.Array, state: TaskState, action: Any, params: TaskParams) -> Any:
        """What the policy is given."""
        return self.task.observe(key, state.state, self.world.params)

    def is_truncated(self, state: TaskState, params: TaskParams) -> jax.Array:
        """Whether the episode is cut off, by the task or by the params; an ending of the task goes before."""
        return ~state.terminated & (state.truncated | (state.time >= params.max_steps_in_episode))

    def is_terminated(self, state: TaskState, params: TaskParams) -> jax.Array:
        """Whether the task has ended the episode."""
        return state.terminated

    @property
    def name(self) -> str:
        """The task's name."""
        return type(self.task).__name__

    @property
    def num_actions(self) -> int:
        """How many actions there are, or numbers in one."""
        space = self.task.action_space
        return space.num_actions if isinstance(space, Discrete) else space.size

    def action_space(self, params: TaskParams | None = None) -> Any:
        """The task's."""
        return _space(self.task.action_space)

    def observation_space(self, params: TaskParams | None = None) -> Any:
        """The task's."""
        return _space(self.task.observation_space)


def _space(space: Any) -> Any:
    """The same space as gymnax has it."""
    if isinstance(space, Discrete):
        return spaces.Discrete(space.num_actions)
    if isinstance(space, Box):
        return spaces.Box(space.low, space.high, space.shape)
    if isinstance(space, dict):
        return spaces.Dict({name: _space(part) for name, part in space.items()})
    return spaces.Tuple([_space(part) for part in space])
