"""PPO's update: what one batch does to the parameters."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax

from pecjax.agents.agent import device_mean
from pecjax.agents.networks import ActorCritic, NetworkSettings, forward
from pecjax.agents.returns import generalized_advantage
from pecjax.agents.rollout import Trajectory
from pecjax.errors import InputError


@dataclass(frozen=True)
class PPOSettings:
    """Settings of PPO; the defaults are the preset `fast`.

    Attributes:
        num_envs, num_steps: B and T; a batch is B × T steps.
        num_epochs, num_minibatches: passes over the batch, and parts that each is cut into.
        shuffle: what a minibatch is drawn from: `steps` takes whole time steps of all
            environments, drawn anew each epoch, and copies nothing between devices; `samples`
            shuffles all samples once, drops the remainder and then only changes the minibatches'
            order (RLlib 0.8.5, `optimizers/multi_gpu_optimizer.py`).
        learning_rate, adam_eps, max_grad_norm: of Adam, with an optional bound on the gradient.
        discount, gae_lambda: γ and λ.
        clip: ε of the clipped surrogate.
        value_clip: how far a value prediction may move in one iteration; None for any distance.
        value_coeff, entropy_coeff: weights of the squared value error and of the entropy.
        kl_coeff: initial weight of KL(old ‖ new); None leaves the term out. It is adapted after
            each iteration: × 1.5 over 2 × `kl_target`, × 0.5 under half of it.
        reward_scale: what rewards are multiplied with for the learner.
        network: of actor and critic.
    """

    num_envs: int = 512
    num_steps: int = 32
    num_epochs: int = 4
    num_minibatches: int = 8
    shuffle: Literal["steps", "samples"] = "steps"
    learning_rate: float = 3e-4
    adam_eps: float = 1e-5
    max_grad_norm: float | None = 0.5
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    value_clip: float | None = None
    value_coeff: float = 0.5
    entropy_coeff: float = 0.01
    kl_coeff: float | None = None
    kl_target: float = 0.01
    reward_scale: float = 1e-3
    network: NetworkSettings = field(default_factory=NetworkSettings)

    @property
    def rows(self) -> int:
        """What a minibatch is drawn from: how many time steps, or samples."""
        return self.num_steps * (self.num_envs if self.shuffle == "samples" else 1)

    @property
    def shares(self) -> int:
        """What devices must divide: the environments."""
        return self.num_envs

    def with_envs(self, num_envs: int) -> PPOSettings:
        """The same with another number of environments."""
        return replace(self, num_envs=num_envs)

    def check(self) -> None:
        """Raises InputError where the batch cannot be cut into the minibatches."""
        if min(self.num_envs, self.num_steps, self.num_epochs, self.num_minibatches) < 1:
            raise InputError("environments, steps, epochs and minibatches must each be 1 or more")
        uneven = self.shuffle == "steps" and self.rows % self.num_minibatches
        if self.num_minibatches > self.rows or uneven:
            raise InputError(
                f"{self.num_minibatches} minibatches do not divide {self.rows} {self.shuffle}; change either"
            )


MIN_KL_COEFF = 1e-30  # float32 would go on to 0, and stay there


class Learner(NamedTuple):
    """Parameters, optimiser state and the adaptive weight of the KL term."""

    params: Any
    optimizer: Any
    kl_coeff: jax.Array


class Batch(NamedTuple):
    """What the loss is taken over, every leaf with the same leading axes."""

    features: jax.Array
    action: jax.Array
    logits: jax.Array
    value: jax.Array
    advantage: jax.Array
    target: jax.Array


def make_optimizer(settings: PPOSettings) -> optax.GradientTransformation:
    """Adam, behind a bound on the gradient's norm if there is one."""
    adam = optax.adam(settings.learning_rate, eps=settings.adam_eps)
    if settings.max_grad_norm is None:
        return adam
    return optax.chain(optax.clip_by_global_norm(settings.max_grad_norm), adam)


def prepare(
    settings: PPOSettings, trajectory: Trajectory, last_value: jax.Array, axis_name: str | None
) -> Batch:
    """Advantages, standardised over the whole batch, and value targets; leaves (T, B, …)."""
    features, logits, value = trajectory.extras
    advantage = generalized_advantage(
        trajectory.reward * settings.reward_scale,
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
    return Batch(features, trajectory.action, logits, value, advantage, target)


def loss(
    network: ActorCritic, settings: PPOSettings, params: Any, batch: Batch, kl_coeff: jax.Array
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The loss and its terms by name, as in RLlib 0.8.5 (`agents/ppo/ppo_tf_policy.py`).

    It is the mean over a minibatch of

        −min(ρ A, clip(ρ, 1 ± ε) A) + k KL(old ‖ new) + c_v E_V − c_e H,
        E_V = max((V − R)², (V_old + clip(V − V_old, ± value_clip) − R)²)

    with no ½ before E_V.
    """
    logits, value = forward(network, params, batch.features)
    new, old = jax.nn.log_softmax(logits), jax.nn.log_softmax(batch.logits)

    def of_action(log_probs: jax.Array) -> jax.Array:
        return jnp.take_along_axis(log_probs, batch.action[..., None], axis=-1)[..., 0]

    ratio = jnp.exp(of_action(new) - of_action(old))
    clipped = jnp.clip(ratio, 1 - settings.clip, 1 + settings.clip)
    surrogate = jnp.minimum(ratio * batch.advantage, clipped * batch.advantage).mean()
    value_error = jnp.square(value - batch.target)
    if settings.value_clip is not None:
        move = jnp.clip(value - batch.value, -settings.value_clip, settings.value_clip)
        value_error = jnp.maximum(value_error, jnp.square(batch.value + move - batch.target))
    kl = jnp.sum(jnp.exp(old) * (old - new), axis=-1).mean()
    entropy = -jnp.sum(jnp.exp(new) * new, axis=-1).mean()
    value_loss = value_error.mean()
    total = -surrogate + settings.value_coeff * value_loss - settings.entropy_coeff * entropy
    if settings.kl_coeff is not None:
        total = total + kl_coeff * kl
    terms = {"policy_loss": -surrogate, "value_loss": value_loss, "kl": kl, "entropy": entropy}
    return total, terms


def update(
    network: ActorCritic,
    optimizer: optax.GradientTransformation,
    settings: PPOSettings,
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
    num_rows = batch.action.shape[0]
    rows = minibatch_rows(settings, key, num_rows)

    def step(carry: tuple[Any, Any], chosen: jax.Array) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        params, optimizer_state = carry
        if settings.shuffle == "samples" and axis_name is not None:
            chosen = _own_share(chosen, axis_name)
        minibatch = jax.tree.map(lambda leaf: leaf[chosen], batch)
        gradient, terms = jax.grad(
            lambda p: loss(network, settings, p, minibatch, learner.kl_coeff), has_aux=True
        )(params)
        gradient, terms = device_mean((gradient, terms), axis_name)
        updates, optimizer_state = optimizer.update(gradient, optimizer_state, params)
        return (optax.apply_updates(params, updates), optimizer_state), terms

    (params, optimizer_state), terms = jax.lax.scan(step, (learner.params, learner.optimizer), rows)
    terms = {name: term[-settings.num_minibatches :].mean() for name, term in terms.items()}
    terms["kl_coeff"] = learner.kl_coeff
    kl_coeff = adapt_kl_coeff(learner.kl_coeff, terms["kl"], settings.kl_target)
    return Learner(params, optimizer_state, kl_coeff), terms


def minibatch_rows(settings: PPOSettings, key: jax.Array, num_rows: int) -> jax.Array:
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
