"""Settings of PPO."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from pecjax.agents.base import Agent, AgentSettings
from pecjax.agents.networks import NetworkSettings
from pecjax.curriculum.base import Sampler
from pecjax.envs.task import Task
from pecjax.errors import InputError
from pecjax.ranges import NOT_NEGATIVE, POSITIVE, SHARE, check_ranges

Signal = Literal[
    "positive_value_loss", "value_loss", "negative_value_loss", "maximised_negative_advantage", "value"
]
_RANGES = {
    "learning_rate": NOT_NEGATIVE,
    "decay_steps": (1, math.inf),
    "adam_eps": NOT_NEGATIVE,
    "max_grad_norm": POSITIVE,
    "discount": SHARE,
    "gae_lambda": SHARE,
    "clip_epsilon": POSITIVE,
    "value_clip": POSITIVE,
    "value_coeff": NOT_NEGATIVE,
    "kl_coeff": NOT_NEGATIVE,
    "kl_target": NOT_NEGATIVE,
    "reward_scale": POSITIVE,
    "auxiliary_coeff": NOT_NEGATIVE,
}


@dataclass(frozen=True)
class PPO(AgentSettings):
    """Proximal policy optimisation (Schulman et al. 2017); the defaults are the preset `fast`.

    Attributes:
        num_epochs, num_minibatches: passes over the batch, and minibatches of each pass.
        shuffle: what a minibatch is drawn from, once an iteration: `steps` takes whole time steps of all
            environments and copies nothing between devices; `samples` shuffles all samples and drops the
            remainder. Epochs then only change the minibatches' order (RLlib 0.8.5,
            `optimizers/multi_gpu_optimizer.py`). A network with a memory learns from sequences: a
            minibatch then has all steps of some environments.
        learning_rate, adam_eps, max_grad_norm: of Adam, with an optional bound on the gradient.
        decay_steps: environment steps over which the learning rate falls linearly to a tenth, where it
            stays; None for a constant rate.
        discount, gae_lambda: γ and λ.
        clip_epsilon: ε of the clipped surrogate.
        value_clip: how far a value prediction may move in one iteration; None for any distance.
        value_coeff, entropy_coeff: weights of the squared value error and of the entropy.
        kl_coeff: initial weight of KL(old ‖ new); None leaves the term out. It is adapted after
            each iteration: × 1.5 over 2 × `kl_target`, × 0.5 under half of it.
        reward_scale: the learner's rewards are multiplied by this.
        signal: the score of each episode for a sampler, in units of the reward. It is the mean over the
            episode's steps of the advantage where it is positive, of its absolute value, of how far it is
            negative, of how far it is negative with the best in between kept, or of the value.
        network: settings of actor and critic.
        auxiliary: the part of what critics are told (by its name in `Task.privileged_space`) that the
            actor's last layer is to predict, too, such as `path` in rooms with `critic_paths`. It is an
            auxiliary task (Mirowski et al. 2017, "Learning to navigate in complex environments"), of
            training alone; None for none.
        auxiliary_coeff: weight of its squared error.
        sequence_length: steps of a sequence, at whose beginning the memory is taken as it was in flight;
            None for all `num_steps`.
    """

    num_epochs: int = 2
    num_minibatches: int = 32
    shuffle: Literal["steps", "samples"] = "steps"
    learning_rate: float = 1e-3
    decay_steps: int | None = None
    adam_eps: float = 1e-5
    max_grad_norm: float | None = 0.5
    discount: float = 0.995
    gae_lambda: float = 0.95
    clip_epsilon: float = 0.2
    value_clip: float | None = None
    value_coeff: float = 0.5
    entropy_coeff: float = 0.01
    kl_coeff: float | None = None
    kl_target: float = 0.01
    reward_scale: float = 1e-3
    signal: Signal = "positive_value_loss"
    network: NetworkSettings = field(default_factory=NetworkSettings)
    sequence_length: int | None = None
    auxiliary: str | None = None
    auxiliary_coeff: float = 0.3

    @property
    def has_memory(self) -> bool:
        """Whether the network has a memory, and learns from sequences."""
        return self.network.memory is not None

    @property
    def steps_of_a_sequence(self) -> int:
        """L, of `sequence_length`."""
        return self.num_steps if self.sequence_length is None else self.sequence_length

    @property
    def rows(self) -> int:
        """What a minibatch is drawn from: how many environments, time steps, or samples."""
        if self.has_memory:
            return self.num_envs
        return self.num_steps * (self.num_envs if self.shuffle == "samples" else 1)

    @property
    def device_divisor(self) -> int:
        """See `AgentSettings`."""
        return self.num_envs // self.num_minibatches if self.has_memory else self.num_envs

    @property
    def divided(self) -> str:
        """What devices share evenly: with a memory each has a part of every minibatch's sequences."""
        return "environments of each minibatch" if self.has_memory else "environments"

    @property
    def gives_signal(self) -> bool:
        """See `AgentSettings`."""
        return True

    @property
    def memory_bytes(self) -> int:
        """The memory of every environment, and that before each sequence, which is in minibatches too."""
        sequences = self.num_steps // self.steps_of_a_sequence
        return 4 * self.network.memory_numbers * self.num_envs * (1 + 2 * sequences)

    @property
    def observations_held(self) -> int:
        """How many observations of float32 an iteration holds: the batch, and once more in minibatches.

        In 16 bits the minibatches are there twice, as rows and transposed.
        """
        batch = self.num_envs * self.num_steps
        return 2 * batch if self.network.precision == "float32" else batch + batch // 2

    def make(self, task: Task, sampler: Sampler, axis_name: str | None = None) -> Agent:
        """A PPO agent (see `AgentSettings.make`)."""
        from pecjax.agents.ppo.agent import make  # which needs this class

        return make(task, sampler, self, axis_name)

    def check(self) -> None:
        """Raises InputError where a number is out of range, or minibatches cannot be cut from the batch."""
        if min(self.num_envs, self.num_steps, self.num_epochs, self.num_minibatches) < 1:
            raise InputError("environments, steps, epochs and minibatches must each be 1 or more")
        check_ranges(self, _RANGES)
        if self.has_memory and self.shuffle == "samples":
            raise InputError("a network with a memory learns from sequences; leave shuffle at 'steps'")
        network = self.network
        if self.has_memory and min(self.steps_of_a_sequence, network.memory_size) < 1:
            raise InputError("sequence-length and memory-size must each be 1 or more")
        if network.memory == "stack" and not 1 <= network.memory_stride <= network.memory_size:
            raise InputError(
                f"memory-stride is {network.memory_stride}; give 1 to memory-size, {network.memory_size}"
            )
        if self.has_memory and self.num_steps % self.steps_of_a_sequence:
            raise InputError(
                f"sequences of {self.sequence_length} do not divide {self.num_steps} steps; change either"
            )
        may_be_uneven = self.shuffle == "samples"
        if self.num_minibatches > self.rows or (self.rows % self.num_minibatches and not may_be_uneven):
            of = "environments" if self.has_memory else self.shuffle
            raise InputError(
                f"{self.num_minibatches} minibatches do not divide {self.rows} {of}; change either"
            )
