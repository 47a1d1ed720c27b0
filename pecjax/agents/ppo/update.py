"""PPO's update of the parameters by one batch."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from pecjax.agents.distributions import Distribution
from pecjax.agents.networks import ActorCritic, forward
from pecjax.agents.ppo.settings import PPO
from pecjax.agents.returns import generalized_advantage, with_bootstrap
from pecjax.agents.rollout import Trajectory
from pecjax.agents.sharding import device_mean

MIN_KL_COEFF = 1e-30  # float32 would shrink to 0, and stay there


class Learner(NamedTuple):
    """Parameters, optimiser state and the adaptive weight of the KL term."""

    params: Any
    optimizer: Any
    kl_coeff: jax.Array


class Batch(NamedTuple):
    """What the loss is taken over, every leaf with the same leading axes.

    Attributes:
        features: of the observation.
        drawn, params: what was drawn, and the parameters of the distribution that it was drawn from.
        value, target: as it was predicted, and as it should have been.
        advantage: of the action.
    """

    features: jax.Array
    drawn: jax.Array
    params: jax.Array
    value: jax.Array
    advantage: jax.Array
    target: jax.Array


def make_optimizer(settings: PPO) -> optax.GradientTransformation:
    """Adam, behind a bound on the gradient's norm if there is one."""
    adam = optax.adam(settings.learning_rate, eps=settings.adam_eps)
    if settings.max_grad_norm is None:
        return adam
    return optax.chain(optax.clip_by_global_norm(settings.max_grad_norm), adam)


def prepare(settings: PPO, trajectory: Trajectory, last_value: jax.Array, axis_name: str | None) -> Batch:
    """Advantages, standardised over the whole batch, and value targets; leaves (T, B, …)."""
    features, drawn, params, value = trajectory.extras
    advantage = generalized_advantage(
        scaled_reward(settings, trajectory),
        value,
        trajectory.done,
        last_value,
        settings.discount,
        settings.gae_lambda,
    )
    target = advantage + value
    mean = device_mean(advantage.mean(), axis_name)
    deviation = jnp.sqrt(device_mean(jnp.square(advantage - mean).mean(), axis_name))
    advantage = (advantage - mean) / jnp.maximum(1e-4, deviation)
    return Batch(features, drawn, params, value, advantage, target)


def scaled_reward(settings: PPO, trajectory: Trajectory) -> jax.Array:
    """Rewards (T, B) as the learner has them, with the value of what a cut left out."""
    reward = trajectory.reward * settings.reward_scale
    return with_bootstrap(reward, trajectory.bootstrap, settings.discount)


def loss(
    network: ActorCritic,
    distribution: Distribution,
    settings: PPO,
    params: Any,
    batch: Batch,
    kl_coeff: jax.Array,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The loss and its terms by name, as in RLlib 0.8.5 (`agents/ppo/ppo_tf_policy.py`).

    It is the mean over a minibatch of

        −min(ρ A, clip(ρ, 1 ± ε) A) + k KL(old ‖ new) + c_v E_V − c_e H,
        E_V = max((V − R)², (V_old + clip(V − V_old, ± value_clip) − R)²)

    with no ½ before E_V.
    """
    new, value = forward(network, params, batch.features)
    log_prob = distribution.log_prob
    ratio = jnp.exp(log_prob(new, batch.drawn) - log_prob(batch.params, batch.drawn))
    clipped = jnp.clip(ratio, 1 - settings.clip_epsilon, 1 + settings.clip_epsilon)
    surrogate = jnp.minimum(ratio * batch.advantage, clipped * batch.advantage).mean()
    value_error = jnp.square(value - batch.target)
    if settings.value_clip is not None:
        move = jnp.clip(value - batch.value, -settings.value_clip, settings.value_clip)
        value_error = jnp.maximum(value_error, jnp.square(batch.value + move - batch.target))
    kl = distribution.kl(batch.params, new).mean()
    entropy = distribution.entropy(new, batch.params, batch.drawn).mean()
    value_loss = value_error.mean()
    total = -surrogate + settings.value_coeff * value_loss - settings.entropy_coeff * entropy
    if settings.kl_coeff is not None:
        total = total + kl_coeff * kl
    terms = {"policy_loss": -surrogate, "value_loss": value_loss, "kl": kl, "entropy": entropy}
    return total, terms


def update(
    network: ActorCritic,
    distribution: Distribution,
    optimizer: optax.GradientTransformation,
    settings: PPO,
    learner: Learner,
    batch: Batch,
    key: jax.Array,
    axis_name: str | None,
) -> tuple[Learner, dict[str, jax.Array]]:
    """All epochs over one batch, and the KL rule; returns the terms of the last epoch."""
    if settings.shuffle == "samples":
        if axis_name is not None:
            batch = jax.lax.all_gather(batch, axis_name, axis=1, tiled=True)
        batch = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), batch)
    num_rows = batch.value.shape[0]
    rows = minibatch_rows(settings, key, num_rows)

    def step(carry: tuple[Any, Any], chosen: jax.Array) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        params, optimizer_state = carry
        if settings.shuffle == "samples" and axis_name is not None:
            chosen = _own_share(chosen, axis_name)
        minibatch = jax.tree.map(lambda leaf: leaf[chosen], batch)
        gradient, terms = jax.grad(
            lambda p: loss(network, distribution, settings, p, minibatch, learner.kl_coeff), has_aux=True
        )(params)
        gradient, terms = device_mean((gradient, terms), axis_name)
        updates, optimizer_state = optimizer.update(gradient, optimizer_state, params)
        return (optax.apply_updates(params, updates), optimizer_state), terms

    (params, optimizer_state), terms = jax.lax.scan(step, (learner.params, learner.optimizer), rows)
    terms = {name: term[-settings.num_minibatches :].mean() for name, term in terms.items()}
    terms["kl_coeff"] = learner.kl_coeff
    kl_coeff = adapt_kl_coeff(learner.kl_coeff, terms["kl"], settings.kl_target)
    return Learner(params, optimizer_state, kl_coeff), terms


def minibatch_rows(settings: PPO, key: jax.Array, num_rows: int) -> jax.Array:
    """Row numbers (epochs × minibatches, rows of a minibatch), the same on every device."""
    size = num_rows // settings.num_minibatches
    shape = (settings.num_minibatches, size)
    once, *keys = jax.random.split(key, settings.num_epochs + 1)
    keys = jnp.stack(keys)
    if settings.shuffle == "samples":
        parts = jax.random.permutation(once, num_rows)[: shape[0] * size].reshape(shape)
        epochs = jax.vmap(lambda k: jax.random.permutation(k, parts))(keys)
    else:
        epochs = jax.vmap(lambda k: jax.random.permutation(k, num_rows).reshape(shape))(keys)
    return epochs.reshape(-1, size)


def adapt_kl_coeff(kl_coeff: jax.Array, kl: jax.Array, target: float) -> jax.Array:
    """RLlib 0.8.5's rule (`agents/ppo/ppo.py`, `update_kl`); a weight above 0 stays above it."""
    factor = jnp.where(kl > 2 * target, 1.5, jnp.where(kl < 0.5 * target, 0.5, 1.0))
    return jnp.maximum(kl_coeff * factor, jnp.minimum(kl_coeff, MIN_KL_COEFF))


def _own_share(rows: jax.Array, axis_name: str) -> jax.Array:
    """This device's part of some rows; all of them where they cannot be shared evenly."""
    num_devices = jax.lax.axis_size(axis_name)
    if rows.size % num_devices:
        return rows
    return rows.reshape(num_devices, -1)[jax.lax.axis_index(axis_name)]
