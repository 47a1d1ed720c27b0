"""Ape-X's update: what batches drawn from the replay do to the parameters and the priorities."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from pecjax.agents import replay
from pecjax.agents.agent import device_mean
from pecjax.agents.q_network import QNetwork, QNetworkSettings, action_values
from pecjax.agents.replay import Replay, ReplaySettings
from pecjax.agents.rollout import env_keys, global_ids
from pecjax.errors import InputError


@dataclass(frozen=True)
class ApexSettings:
    """Settings of Ape-X DQN; the defaults are the preset `apex-fast`.

    Attributes:
        num_envs, num_steps: B, and steps that each environment takes in an iteration.
        num_actors: W, the ε that there are, dealt out to the environments in turn.
        epsilon, epsilon_exponent: actor i explores with ε^(1 + exponent · i / (W − 1)).
        fragment: steps of every environment between two rounds of learning.
        n_step, discount: n and γ.
        batch_size: transitions of one update, over all shards.
        replay_ratio: transitions trained on for each environment step.
        learning_starts: environment steps before the first update.
        target_period: the target network is copied once more than so many transitions have been
            trained on since.
        learning_rate, adam_eps, max_grad_norm: of Adam, with a bound on each array's gradient.
        decay_updates: updates over which the rate falls evenly to a tenth, where it stays; None
            for a constant rate.
        huber: |TD error| from which on the loss is linear.
        reward_scale: what rewards are multiplied with for the learner.
        network, replay: theirs.
    """

    num_envs: int = 512
    num_steps: int = 32
    num_actors: int = 8
    epsilon: float = 0.4
    epsilon_exponent: float = 7.0
    fragment: int = 2
    n_step: int = 10
    discount: float = 0.99
    batch_size: int = 1024
    replay_ratio: float = 2.0
    learning_starts: int = 16_384
    target_period: int = 100_000
    learning_rate: float = 2e-4
    decay_updates: int | None = 11_200
    adam_eps: float = 1e-8
    max_grad_norm: float = 40.0
    huber: float = 1.0
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
        return round(self.replay_ratio * self.fragment * self.num_envs / self.batch_size)

    @property
    def shares(self) -> int:
        """What devices must divide: the replay's shards."""
        return self.replay.num_shards

    def with_envs(self, num_envs: int) -> ApexSettings:
        """The same with another number of environments, and as many steps between updates."""
        steps = self.fragment * self.num_envs
        return dataclasses.replace(self, num_envs=num_envs, fragment=max(1, steps // max(num_envs, 1)))

    def check(self) -> None:
        """Raises InputError where the numbers do not fit one another."""
        shards, steps = self.replay.num_shards, self.fragment * self.num_envs
        if min(self.num_envs, self.num_steps, self.num_actors, self.fragment, self.n_step, shards) < 1:
            raise InputError(
                "environments, steps, actors, fragment, n-step and shards must each be 1 or more"
            )
        if self.num_envs % shards or self.batch_size % shards:
            raise InputError(
                f"{shards} shards do not divide {self.num_envs} environments and a batch of "
                f"{self.batch_size}; change either"
            )
        if self.num_steps % self.fragment or self.replay.capacity % steps:
            raise InputError(
                f"fragments of {self.fragment} steps do not divide {self.num_steps} steps and a replay of "
                f"{self.replay.capacity} transitions of {self.num_envs} environments; change either"
            )
        if self.num_rows <= self.fragment + self.n_step:
            raise InputError(
                f"a replay of {self.replay.capacity} transitions holds {self.num_rows} steps of "
                f"{self.num_envs} environments; it needs more than {self.fragment + self.n_step}"
            )
        if self.updates < 1 or abs(self.updates * self.batch_size - self.replay_ratio * steps) > 0.5:
            raise InputError(
                f"replay ratio {self.replay_ratio:g} of {steps} steps is not a whole number of batches "
                f"of {self.batch_size}; change either"
            )


class Learner(NamedTuple):
    """Networks and optimiser.

    Attributes:
        params, target: of the online and of the target network.
        optimizer: its state.
        sampled, updates: () int32, environment steps taken, and updates made, in all; they stop at
            the greatest number of their type.
        copied: () int32, transitions trained on since the target was copied.
    """

    params: Any
    target: Any
    optimizer: Any
    sampled: jax.Array
    updates: jax.Array
    copied: jax.Array


def count_on(count: jax.Array, number: int) -> jax.Array:
    """The count (int32) and so many more, or its type's greatest number where that is less."""
    return jnp.minimum(count, jnp.iinfo(count.dtype).max - number) + number


def make_optimizer(settings: ApexSettings) -> optax.GradientTransformation:
    """Adam, behind a bound on the norm of each array's gradient (RLlib 0.8.5, `minimize_and_clip`)."""

    def bound(gradient: jax.Array) -> jax.Array:
        norm = jnp.linalg.norm(gradient)
        return gradient * jnp.minimum(1.0, settings.max_grad_norm / jnp.maximum(norm, 1e-12))

    clip = optax.stateless(lambda gradients, _: jax.tree.map(bound, gradients))
    rate: optax.ScalarOrSchedule = settings.learning_rate
    if settings.decay_updates is not None:
        rate = optax.linear_schedule(rate, 0.1 * rate, settings.decay_updates)
    return optax.chain(clip, optax.adam(rate, eps=settings.adam_eps))


def double_value(q_online: jax.Array, q_target: jax.Array) -> jax.Array:
    """The target network's value of the online network's choice (van Hasselt et al. 2016), (…,)."""
    choice = jnp.argmax(q_online, axis=-1, keepdims=True)
    return jnp.take_along_axis(q_target, choice, axis=-1)[..., 0]


def update(
    network: QNetwork,
    optimizer: optax.GradientTransformation,
    settings: ApexSettings,
    features: Any,
    learner: Learner,
    shards: Replay,
    key: jax.Array,
    axis_name: str | None,
) -> tuple[Learner, Replay, dict[str, jax.Array]]:
    """One round of learning: each update draws a batch, learns, and gives it new priorities.

    Args:
        features: (Frame) -> features.
        shards: this device's shards of the replay, on a leading axis.

    Returns:
        learner, shards and the means of the updates' figures by name.
    """
    shard_ids = global_ids(shards.head.shape[0], axis_name)
    share = settings.batch_size // settings.replay.num_shards

    def draw(shard: Replay, key: jax.Array) -> replay.Batch:
        return replay.sample(settings.replay, shard, key, share, settings.shard_envs, settings.n_step)

    def loss(params: Any, batch: replay.Batch, following: jax.Array) -> tuple[jax.Array, jax.Array]:
        q = action_values(network, params, features(batch.frame))
        q = jnp.take_along_axis(q, batch.action[..., None], axis=-1)[..., 0]
        error = batch.reward + batch.discount * following - q
        return jnp.mean(batch.weight * optax.huber_loss(error, delta=settings.huber)), error

    def step(carry: tuple[Learner, Replay], key: jax.Array) -> tuple[tuple[Learner, Replay], dict]:
        learner, shards = carry
        batch = jax.vmap(draw)(shards, env_keys(key, shard_ids))
        ahead = features(batch.next_frame)
        following = double_value(
            action_values(network, learner.params, ahead), action_values(network, learner.target, ahead)
        )
        (value, error), gradient = jax.value_and_grad(loss, has_aux=True)(learner.params, batch, following)
        terms = {"loss": value, "td_error": jnp.abs(error).mean(), "value": following.mean()}
        gradient, terms = device_mean((gradient, terms), axis_name)
        shards = jax.vmap(
            lambda shard, leaf, error: replay.reprioritize(settings.replay, shard, leaf, error)
        )(shards, batch.leaf, jnp.abs(error))
        updates, optimizer_state = optimizer.update(gradient, learner.optimizer, learner.params)
        params = optax.apply_updates(learner.params, updates)
        trained = learner.copied + settings.batch_size
        due = trained > settings.target_period
        target = jax.tree.map(lambda new, old: jnp.where(due, new, old), params, learner.target)
        copied = jnp.where(due, 0, trained)
        learner = Learner(
            params, target, optimizer_state, learner.sampled, count_on(learner.updates, 1), copied
        )
        return (learner, shards), terms

    (learner, shards), terms = jax.lax.scan(step, (learner, shards), jax.random.split(key, settings.updates))
    return learner, shards, {name: term.mean() for name, term in terms.items()}
