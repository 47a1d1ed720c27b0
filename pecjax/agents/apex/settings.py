"""Settings of Ape-X DQN."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from pecjax.agents.apex.q_network import QNetworkSettings
from pecjax.agents.apex.replay import ReplaySettings
from pecjax.agents.base import Agent, AgentSettings
from pecjax.curriculum.base import Sampler
from pecjax.envs.task import Task
from pecjax.errors import InputError
from pecjax.ranges import NOT_NEGATIVE, POSITIVE, SHARE, check_ranges

_RANGES = {
    "epsilon": SHARE,
    "epsilon_exponent": NOT_NEGATIVE,
    "discount": SHARE,
    "learning_starts": NOT_NEGATIVE,
    "target_period": NOT_NEGATIVE,
    "learning_rate": NOT_NEGATIVE,
    "decay_steps": (1, math.inf),
    "adam_eps": NOT_NEGATIVE,
    "max_grad_norm": POSITIVE,
    "huber_delta": POSITIVE,
    "reward_scale": POSITIVE,
}
_RANGES_OF_REPLAY = {"alpha": NOT_NEGATIVE, "beta": NOT_NEGATIVE, "epsilon": NOT_NEGATIVE}


@dataclass(frozen=True)
class Apex(AgentSettings):
    """Ape-X DQN (Horgan et al. 2018); the defaults are the preset `apex-fast`.

    Attributes:
        num_actors: W, the number of different ε, given to the environments in turn.
        epsilon, epsilon_exponent: actor i explores with ε^(1 + exponent · i / (W − 1)).
        rollout_length: steps of every environment between two rounds of learning.
        n_step, discount: n and γ.
        batch_size: transitions of one update, over all shards.
        replay_ratio: transitions trained on for each environment step.
        learning_starts: environment steps before the first update.
        target_period: the target network is copied after training on more than this many transitions.
        learning_rate, adam_eps, max_grad_norm: of Adam, with a bound on each array's gradient.
        decay_steps: environment steps, from the first update on, over which the learning rate falls
            linearly to a tenth, where it stays; None for a constant rate.
        huber_delta: the absolute TD error above which the loss is linear.
        reward_scale: the learner's rewards are multiplied by this.
        network, replay: their settings.
    """

    num_actors: int = 8
    epsilon: float = 0.4
    epsilon_exponent: float = 7.0
    rollout_length: int = 2
    n_step: int = 10
    discount: float = 0.99
    batch_size: int = 1024
    replay_ratio: float = 2.0
    learning_starts: int = 16_384
    target_period: int = 100_000
    learning_rate: float = 2e-4
    decay_steps: int | None = 5_734_400
    adam_eps: float = 1e-8
    max_grad_norm: float = 40.0
    huber_delta: float = 1.0
    reward_scale: float = 1e-3
    network: QNetworkSettings = QNetworkSettings()
    replay: ReplaySettings = ReplaySettings()

    @property
    def num_rows(self) -> int:
        """T, rows of the replay's ring."""
        return self.replay.capacity // self.num_envs

    @property
    def shard_envs(self) -> int:
        """Environments of one shard."""
        return self.num_envs // self.replay.num_shards

    @property
    def updates(self) -> int:
        """Updates of one round of learning."""
        return round(self.replay_ratio * self.rollout_length * self.num_envs / self.batch_size)

    def make(self, task: Task, sampler: Sampler, axis_name: str | None = None) -> Agent:
        """An Ape-X agent (see `AgentSettings.make`); the devices must divide the replay's shards."""
        from pecjax.agents.apex.agent import make  # which needs this class

        return make(task, sampler, self, axis_name)

    @property
    def observations_held(self) -> int:
        """How many observations a round holds at once, besides the replay's."""
        return self.num_envs * self.rollout_length

    @property
    def device_divisor(self) -> int:
        """See `AgentSettings`."""
        return self.replay.num_shards

    @property
    def divided(self) -> str:
        """What devices share evenly."""
        return "replay shards"

    def with_envs(self, num_envs: int) -> Apex:
        """The same with another number of environments, and as many steps between updates."""
        steps = self.rollout_length * self.num_envs
        return dataclasses.replace(self, num_envs=num_envs, rollout_length=max(1, steps // max(num_envs, 1)))

    def check(self) -> None:
        """Raises InputError where the numbers do not fit one another."""
        check_ranges(self, _RANGES)
        check_ranges(self.replay, _RANGES_OF_REPLAY)
        shards, steps = self.replay.num_shards, self.rollout_length * self.num_envs
        of_rollouts = min(self.num_envs, self.num_steps, self.num_actors, self.rollout_length)
        if min(of_rollouts, self.n_step, self.batch_size, shards) < 1:
            raise InputError(
                "environments, steps, actors, rollout-length, n-step, batch-size and shards must each be 1 "
                "or more"
            )
        if self.num_envs % shards or self.batch_size % shards:
            raise InputError(
                f"{shards} shards do not divide {self.num_envs} environments and a batch of "
                f"{self.batch_size}; change either"
            )
        if self.num_envs < self.num_actors:
            raise InputError(
                f"{self.num_actors} actors need an environment each and there are {self.num_envs}; change "
                "either"
            )
        if self.num_steps % self.rollout_length or self.replay.capacity % steps:
            raise InputError(
                f"rollouts of {self.rollout_length} steps do not divide {self.num_steps} steps and a replay "
                f"of {self.replay.capacity} transitions of {self.num_envs} environments; change either"
            )
        if self.num_rows <= self.rollout_length + self.n_step:
            raise InputError(
                f"a replay of {self.replay.capacity} transitions holds {self.num_rows} steps of "
                f"{self.num_envs} environments; it needs more than {self.rollout_length + self.n_step}"
            )
        if self.updates < 1 or abs(self.updates * self.batch_size - self.replay_ratio * steps) > 0.5:
            raise InputError(
                f"replay ratio {self.replay_ratio:g} of {steps} steps is not a whole number of batches "
                f"of {self.batch_size}; change either"
            )
