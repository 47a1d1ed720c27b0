"""Ape-X's update of parameters and priorities by batches from the replay."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from pecjax.agents.apex import replay
from pecjax.agents.apex.q_network import QNetwork, action_values
from pecjax.agents.apex.replay import Replay
from pecjax.agents.apex.settings import Apex
from pecjax.agents.episodes import count_on
from pecjax.agents.rates import falling_rate
from pecjax.agents.sharding import device_mean, env_keys, global_ids


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


def make_optimizer(settings: Apex) -> optax.GradientTransformation:
    """Adam, behind a bound on the norm of each array's gradient (RLlib 0.8.5, `minimize_and_clip`)."""

    def bound(gradient: jax.Array) -> jax.Array:
        norm = jnp.linalg.norm(gradient)
        return gradient * jnp.minimum(1.0, settings.max_grad_norm / jnp.maximum(norm, 1e-12))

    clip = optax.stateless(lambda gradients, _: jax.tree.map(bound, gradients))
    updates = settings.replay_ratio / settings.batch_size
    rate = falling_rate(settings.learning_rate, settings.decay_steps, updates)
    return optax.chain(clip, optax.adam(rate, eps=settings.adam_eps))


def double_value(q_online: jax.Array, q_target: jax.Array) -> jax.Array:
    """The target network's value of the online network's choice (van Hasselt et al. 2016), (…,)."""
    choice = jnp.argmax(q_online, axis=-1, keepdims=True)
    return jnp.take_along_axis(q_target, choice, axis=-1)[..., 0]


def update(
    network: QNetwork,
    optimizer: optax.GradientTransformation,
    settings: Apex,
    features: Any,
    learner: Learner,
    shards: Replay,
    key: jax.Array,
    axis_name: str | None,
) -> tuple[Learner, Replay, dict[str, jax.Array]]:
    """One round of learning: each update draws a batch, learns, and gives it new priorities.

    Args:
        features: (packed observations) -> features.
        shards: this device's shards of the replay, on a leading axis.

    Returns:
        learner, shards and the means of the updates' figures by name.
    """
    shard_ids = global_ids(shards.head.shape[0], axis_name)
    share = settings.batch_size // settings.replay.num_shards

    def draw(shard: Replay, key: jax.Array) -> replay.Batch:
        return replay.sample(settings.replay, shard, key, share, settings.shard_envs, settings.n_step)

    def loss(params: Any, batch: replay.Batch, following: jax.Array) -> tuple[jax.Array, jax.Array]:
        q = action_values(network, params, features(batch.obs))
        q = jnp.take_along_axis(q, batch.action[..., None], axis=-1)[..., 0]
        error = batch.reward + batch.discount * following - q
        return jnp.mean(batch.weight * optax.huber_loss(error, delta=settings.huber_delta)), error

    def step(carry: tuple[Learner, Replay], key: jax.Array) -> tuple[tuple[Learner, Replay], dict]:
        learner, shards = carry
        batch = jax.vmap(draw)(shards, env_keys(key, shard_ids))
        ahead = features(batch.next_obs)
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
