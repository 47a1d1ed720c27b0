"""The agent's contract: its functions, the state of a training, and how a run names one."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import jax

from pecjax.agents.metrics import Metrics
from pecjax.curriculum.base import Sampler
from pecjax.envs.task import Task, World
from pecjax.errors import InputError

Self = TypeVar("Self", bound="AgentSettings")


class TrainState(NamedTuple):
    """The whole state of a training; saving it saves the run.

    Attributes:
        learner: parameters and optimiser, the agent's own.
        sampler: the sampler's state.
        counts: (3, N) int32, trials, failures and steps of each configuration since the beginning.
        envs: the environments and what the agent keeps of each; the only part that is spread over
            devices, by its leading axis.
        key: for all randomness to come.
    """

    learner: Any
    sampler: Any
    counts: Any
    envs: Any
    key: Any


class Agent(NamedTuple):
    """A learner, a sampler and their environments as pure functions.

    Attributes:
        init: (key, world, numbers=None) -> TrainState; the numbers are for `Sampler.init`.
        iterate: (TrainState, world) -> (TrainState, Metrics), one iteration of the paper's Fig. 1
            (lines 2-16).
        policy: (TrainState.learner, greedy=False) -> act, where act(obs, key) -> action for a
            single observation; with a memory, act(obs, key, memory) -> (action, memory after it).
        steps_per_iteration: environment steps of one iteration, over all environments.
        replay_bytes: size of the replay, over all devices.
        first_memory: what its policies carry where an episode begins; None of an agent without memory.
    """

    init: Callable[..., TrainState]
    iterate: Callable[[TrainState, World], tuple[TrainState, Metrics]]
    policy: Callable[..., Callable[[Any, jax.Array], jax.Array]]
    steps_per_iteration: int
    replay_bytes: int = 0
    first_memory: Any = None


@dataclass(frozen=True)
class AgentSettings(abc.ABC):
    """A kind of agent with its numbers. Extend it by a frozen dataclass to use it in a run.

    Attributes:
        num_envs, num_steps: B, and the steps T that each environment takes in an iteration.
    """

    num_envs: int = 512
    num_steps: int = 32

    @abc.abstractmethod
    def make(self, task: Task, sampler: Sampler, axis_name: str | None = None) -> Agent:
        """An agent that learns the task in configurations that the sampler draws.

        Args:
            axis_name: the mesh axis it will be sharded over (see `sharding.shard`), None for one device.

        Raises:
            InputError: the settings do not fit one another, or the agent cannot learn the task.
        """

    def check(self) -> None:
        """Raises InputError where the numbers do not fit one another."""
        if min(self.num_envs, self.num_steps) < 1:
            raise InputError("num-envs and num-steps must each be 1 or more")

    @property
    def device_divisor(self) -> int:
        """What the number of devices must divide: how many there are of `divided`."""
        return self.num_envs

    @property
    def divided(self) -> str:
        """What devices share evenly."""
        return "environments"

    @property
    def gives_signal(self) -> bool:
        """Whether its episodes have a signal (see `Outcomes`), which some samplers need."""
        return False

    @property
    def memory_bytes(self) -> int:
        """What an iteration holds of the network's memory."""
        return 0

    @property
    def observations_held(self) -> int:
        """How many observations of float32 an iteration holds at once."""
        return self.num_envs * self.num_steps

    def with_envs(self: Self, num_envs: int) -> Self:
        """The same with another number of environments."""
        return dataclasses.replace(self, num_envs=num_envs)
