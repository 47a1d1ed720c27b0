"""PPO: proximal policy optimisation (Schulman et al. 2017), one iteration as one program."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax

from pecjax.agents.agent import Agent, Metrics, TrainState, summarize
from pecjax.agents.networks import ActorCritic, NetworkSettings, forward
from pecjax.agents.returns import generalized_advantage
from pecjax.agents.rollout import Trajectory, launch, rollout
from pecjax.curriculum.sampler import Sampler
from pecjax.errors import InputError
from pecjax.world.coordinates import Configurations
from pecjax.world.navigation import RoomsNavigation, observation


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


class Learner(NamedTuple):
    """Parameters, optimiser state and the adaptive weight of the KL term."""

    params: Any
    optimizer: Any
    kl_coeff: jax.Array


class Batch(NamedTuple):
    """What the loss is taken over, every leaf with the same leading axes."""

    obs: Any
    action: jax.Array
    logits: jax.Array
    value: jax.Array
    advantage: jax.Array
    target: jax.Array


def make(
    env: RoomsNavigation,
    table: Configurations,
    sampler: Sampler,
    settings: PPOSettings = PPOSettings(),
    axis_name: str | None = None,
) -> Agent:
    """A PPO agent that flies configurations of `table` as `sampler` draws them.

    Args:
        axis_name: the mesh axis it will be sharded over (see `agents.agent.shard`), None for one
            device.

    Raises:
        InputError: minibatches that do not divide the batch.
    """
    rows = settings.num_steps * (settings.num_envs if settings.shuffle == "samples" else 1)
    if settings.num_minibatches > rows or (settings.shuffle == "steps" and rows % settings.num_minibatches):
        raise InputError(
            f"{settings.num_minibatches} minibatches do not divide {rows} {settings.shuffle}; change either"
        )
    network = ActorCritic(settings.network, env.action_size, env.scene.camera.far)
    optimizer = optax.adam(settings.learning_rate, eps=settings.adam_eps)
    if settings.max_grad_norm is not None:
        optimizer = optax.chain(optax.clip_by_global_norm(settings.max_grad_norm), optimizer)

    def init(key: jax.Array) -> TrainState:
        key, key_params, key_fleet = jax.random.split(key, 3)
        sampler_state = sampler.init()
        fleet = launch(env, table, sampler, sampler_state, key_fleet, settings.num_envs)
        params = network.init(key_params, jax.tree.map(lambda leaf: leaf[:1], fleet.state.obs))
        kl_coeff = jnp.asarray(settings.kl_coeff or 0.0, jnp.float32)
        return TrainState(Learner(params, optimizer.init(params), kl_coeff), sampler_state, fleet, key)

    def iterate(state: TrainState) -> tuple[TrainState, Metrics]:
        learner = state.learner
        key, key_rollout, key_update = jax.random.split(state.key, 3)

        def act(obs: Any, keys: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
            logits, value = forward(network, learner.params, obs)
            return jax.vmap(jax.random.categorical)(keys, logits), (logits, value)

        num_local = state.fleet.config_id.shape[0]
        first = 0 if axis_name is None else jax.lax.axis_index(axis_name) * num_local
        fleet, trajectory, episodes = rollout(
            env,
            table,
            sampler,
            state.sampler,
            act,
            state.fleet,
            key_rollout,
            first + jnp.arange(num_local),
            settings.num_steps,
        )
        _, last_value = forward(network, learner.params, observation(fleet.state))
        batch = prepare(settings, trajectory, last_value, axis_name)
        learner, losses = update(network, optimizer, settings, learner, batch, key_update, axis_name)
        sampler_state = sampler.update(state.sampler, episodes.outcomes, axis_name)
        metrics = summarize(episodes, losses, table.size, axis_name)
        return TrainState(learner, sampler_state, fleet, key), metrics

    def policy(learner: Learner, greedy: bool = False):
        def act(obs: Any, key: jax.Array) -> jax.Array:
            logits, _ = forward(network, learner.params, obs)
            return jnp.argmax(logits) if greedy else jax.random.categorical(key, logits)

        return act

    return Agent(init, iterate, policy, settings.num_envs * settings.num_steps)


def prepare(
    settings: PPOSettings, trajectory: Trajectory, last_value: jax.Array, axis_name: str | None
) -> Batch:
    """Advantages, standardised over the whole batch, and value targets; leaves (T, B, …)."""
    logits, value = trajectory.extras
    advantage = generalized_advantage(
        trajectory.reward * settings.reward_scale,
        value,
        trajectory.done,
        last_value,
        settings.discount,
        settings.gae_lambda,
    )
    target = advantage + value
    mean = _device_mean(advantage.mean(), axis_name)
    deviation = jnp.sqrt(_device_mean(jnp.square(advantage - mean).mean(), axis_name))
    advantage = (advantage - mean) / jnp.maximum(1e-4, deviation)
    return Batch(trajectory.obs, trajectory.action, logits, value, advantage, target)


def loss(
    network: ActorCritic, settings: PPOSettings, params: Any, batch: Batch, kl_coeff: jax.Array
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The loss and its terms by name, as in RLlib 0.8.5 (`agents/ppo/ppo_tf_policy.py`).

    It is the mean over a minibatch of

        −min(ρ A, clip(ρ, 1 ± ε) A) + k KL(old ‖ new) + c_v E_V − c_e H,
        E_V = max((V − R)², (V_old + clip(V − V_old, ± value_clip) − R)²)

    with no ½ before E_V.
    """
    logits, value = forward(network, params, batch.obs)
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
        batch = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), batch)
        if axis_name is not None:
            batch = jax.lax.all_gather(batch, axis_name, tiled=True)
    num_rows = batch.action.shape[0]
    rows = minibatch_rows(settings, key, num_rows)

    def step(carry: tuple[Any, Any], chosen: jax.Array) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        params, optimizer_state = carry
        if settings.shuffle == "samples" and axis_name is not None:
            chosen = chosen.reshape(jax.lax.axis_size(axis_name), -1)[jax.lax.axis_index(axis_name)]
        minibatch = jax.tree.map(lambda leaf: leaf[chosen], batch)
        gradient, terms = jax.grad(
            lambda p: loss(network, settings, p, minibatch, learner.kl_coeff), has_aux=True
        )(params)
        gradient, terms = _device_mean((gradient, terms), axis_name)
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
    keys = jax.random.split(key, settings.num_epochs)
    if settings.shuffle == "samples":
        key, once = jax.random.split(key)
        parts = jax.random.permutation(once, num_rows)[: shape[0] * size].reshape(shape)
        epochs = jax.vmap(lambda k: jax.random.permutation(k, parts))(keys)
    else:
        epochs = jax.vmap(lambda k: jax.random.permutation(k, num_rows).reshape(shape))(keys)
    return epochs.reshape(-1, size)


def adapt_kl_coeff(kl_coeff: jax.Array, kl: jax.Array, target: float) -> jax.Array:
    """RLlib 0.8.5's rule (`agents/ppo/ppo.py`, `update_kl`)."""
    factor = jnp.where(kl > 2 * target, 1.5, jnp.where(kl < 0.5 * target, 0.5, 1.0))
    return kl_coeff * factor


def _device_mean(tree: Any, axis_name: str | None) -> Any:
    return tree if axis_name is None else jax.lax.pmean(tree, axis_name)
