"""PPO's update of the parameters by one batch."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from pecjax.agents.distributions import Distribution
from pecjax.agents.networks import ActorCritic, forward
from pecjax.agents.ppo.minibatches import cut
from pecjax.agents.ppo.settings import PPO
from pecjax.agents.rates import falling_rate
from pecjax.agents.returns import generalized_advantage, with_bootstrap
from pecjax.agents.rollout import Trajectory
from pecjax.agents.sharding import device_mean

MIN_KL_COEFF = 1e-30  # float32 would shrink to 0, and stay there


class Learner(NamedTuple):
    """Parameters, optimiser state and the adaptive weight of the KL term."""

    params: Any
    optimizer: Any
    kl_coeff: jax.Array


class Flown(NamedTuple):
    """What is kept of every step of a rollout (`Trajectory.extras`); each as in `Batch`."""

    features: jax.Array
    known: jax.Array | None
    drawn: jax.Array
    params: jax.Array
    value: jax.Array
    told: jax.Array | None = None


class Batch(NamedTuple):
    """What the loss is taken over; leaves have the same leading axes, but for the memory.

    Attributes:
        features, known: of the observation, and the critic's own where it has any, else None.
        columns: the features transposed in memory, where products are of 16 bits, else None.
        drawn, params: what was drawn, and the parameters of the distribution that it was drawn from.
        log_prob: of what was drawn.
        value, target: as it was predicted, and as it should have been.
        advantage: of the action.
        memory: before each sequence, (T / L, B, H); None of a network without one.
        starts: 1 where the step is an episode's first; None likewise.
        told: (…, A), what the actor is to predict; None where that is nothing.
    """

    features: jax.Array
    known: jax.Array | None
    columns: jax.Array | None
    drawn: jax.Array
    params: jax.Array
    log_prob: jax.Array
    value: jax.Array
    advantage: jax.Array
    target: jax.Array
    memory: jax.Array | None = None
    starts: jax.Array | None = None
    told: jax.Array | None = None


def make_optimizer(settings: PPO) -> optax.GradientTransformation:
    """Adam, behind a bound on the gradient's norm if there is one."""
    updates = settings.num_epochs * settings.num_minibatches / (settings.num_envs * settings.num_steps)
    rate = falling_rate(settings.learning_rate, settings.decay_steps, updates)
    adam = optax.adam(rate, eps=settings.adam_eps)
    if settings.max_grad_norm is None:
        return adam
    return optax.chain(optax.clip_by_global_norm(settings.max_grad_norm), adam)


def prepare(
    settings: PPO,
    distribution: Distribution,
    trajectory: Trajectory,
    last_value: jax.Array,
    axis_name: str | None,
) -> Batch:
    """Advantages, standardised over the whole batch, and value targets; leaves (T, B, …)."""
    features, known, drawn, params, value, told = trajectory.extras  # Flown
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
    log_prob = distribution.log_prob(params, drawn)
    memory, starts = trajectory.memory, None
    if memory is not None:
        done = trajectory.done
        starts = jnp.concatenate([jnp.zeros_like(done[:1]), done[:-1]])
    of_steps = (features, known, None, drawn, params, log_prob, value, advantage, target)
    return Batch(*of_steps, memory, starts, told)


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

        −min(ρ A, clip(ρ, 1 ± ε) A) + k KL(old ‖ new) + c_v E_V − c_e H (+ c_a E_A),
        E_V = max((V − R)², (V_old + clip(V − V_old, ± value_clip) − R)²)

    with no ½ before E_V. Where k is None, `kl` is an estimate that takes less time, the mean of
    ρ − 1 − log ρ, which has the same mean and is never negative (Schulman 2020, "Approximating KL
    divergence"). E_A is the squared error of an auxiliary task, if there is one.
    """
    new, value, _, predicted = forward(
        network, params, batch.features, batch.known, batch.columns, batch.memory, batch.starts
    )
    log_ratio = distribution.log_prob(new, batch.drawn) - batch.log_prob
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - settings.clip_epsilon, 1 + settings.clip_epsilon)
    surrogate = jnp.minimum(ratio * batch.advantage, clipped * batch.advantage).mean()
    value_error = jnp.square(value - batch.target)
    if settings.value_clip is not None:
        move = jnp.clip(value - batch.value, -settings.value_clip, settings.value_clip)
        value_error = jnp.maximum(value_error, jnp.square(batch.value + move - batch.target))
    if settings.kl_coeff is None:  # only to be reported
        kl = (ratio - 1 - log_ratio).mean()
    else:
        kl = distribution.kl(batch.params, new).mean()
    entropy = distribution.entropy(new, batch.params, batch.drawn).mean()
    value_loss = value_error.mean()
    total = -surrogate + settings.value_coeff * value_loss - settings.entropy_coeff * entropy
    if settings.kl_coeff is not None:
        total = total + kl_coeff * kl
    terms = {"policy_loss": -surrogate, "value_loss": value_loss, "kl": kl, "entropy": entropy}
    if batch.told is not None:
        terms["auxiliary_loss"] = jnp.square(predicted - batch.told).mean()
        total = total + settings.auxiliary_coeff * terms["auxiliary_loss"]
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
    minibatches, order = cut(settings, key, batch, axis_name)
    if settings.network.precision == "bfloat16":
        minibatches = minibatches._replace(columns=jnp.swapaxes(minibatches.features, 1, 2))

    def step(carry: tuple[Any, Any], number: jax.Array) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        params, optimizer_state = carry
        minibatch = jax.tree.map(lambda leaf: leaf[number], minibatches)
        gradient, terms = jax.grad(
            lambda p: loss(network, distribution, settings, p, minibatch, learner.kl_coeff), has_aux=True
        )(params)
        gradient, terms = device_mean((gradient, terms), axis_name)
        updates, optimizer_state = optimizer.update(gradient, optimizer_state, params)
        return (optax.apply_updates(params, updates), optimizer_state), terms

    (params, optimizer_state), terms = jax.lax.scan(step, (learner.params, learner.optimizer), order)
    terms = {name: term[-settings.num_minibatches :].mean() for name, term in terms.items()}
    terms["kl_coeff"] = learner.kl_coeff
    kl_coeff = adapt_kl_coeff(learner.kl_coeff, terms["kl"], settings.kl_target)
    return Learner(params, optimizer_state, kl_coeff), terms


def adapt_kl_coeff(kl_coeff: jax.Array, kl: jax.Array, target: float) -> jax.Array:
    """RLlib 0.8.5's rule (`agents/ppo/ppo.py`, `update_kl`); a weight above 0 stays above it."""
    factor = jnp.where(kl > 2 * target, 1.5, jnp.where(kl < 0.5 * target, 0.5, 1.0))
    return jnp.maximum(kl_coeff * factor, jnp.minimum(kl_coeff, MIN_KL_COEFF))
