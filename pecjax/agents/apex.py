"""Ape-X DQN: distributed prioritised replay (Horgan et al. 2018), one iteration as one program."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.agents import replay
from pecjax.agents.agent import Agent, Metrics, TrainState, are_finite, summarize
from pecjax.agents.apex_update import (
    ApexSettings,
    Learner,
    count_on,
    double_value,
    make_optimizer,
    update,
)
from pecjax.agents.networks import encode
from pecjax.agents.q_network import QNetwork, action_values
from pecjax.agents.replay import Frame, Replay, Rows, compress, expand
from pecjax.agents.returns import n_step_return
from pecjax.agents.rollout import Episodes, RolloutState, Trajectory, global_ids, init_rollout, rollout
from pecjax.curriculum.base import Sampler
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.navigation import RoomsNavigation, observation


class Recent(NamedTuple):
    """The last n steps of every environment, whose returns are not yet known: leaves (B, n).

    Attributes:
        action, reward, done: as of `Trajectory`, the reward scaled.
        value: the online network's, of the action taken.
        known: whether there was such a step.
    """

    action: jax.Array
    reward: jax.Array
    done: jax.Array
    value: jax.Array
    known: jax.Array


class Actors(NamedTuple):
    """What is spread over devices: environments, their recent steps, and the replay's shards."""

    fleet: RolloutState
    recent: Recent
    shards: Replay


def exploration(settings: ApexSettings, env_ids: jax.Array) -> jax.Array:
    """ε of each environment (Horgan et al. 2018, §4.1), actors dealt out in turn."""
    actor = env_ids % settings.num_actors
    return settings.epsilon ** (1 + settings.epsilon_exponent * actor / max(settings.num_actors - 1, 1))


def explore(values: jax.Array, epsilon: jax.Array, chance: jax.Array) -> jax.Array:
    """ε-greedy actions (…,) for action values (…, A), from one uniform number each."""
    number = values.shape[-1]
    # Below ε the chance is uniform in [0, ε), and says which action too.
    anything = jnp.minimum(chance / epsilon * number, number - 1).astype(jnp.int32)
    return jnp.where(chance < epsilon, anything, jnp.argmax(values, axis=-1).astype(jnp.int32))


def make(
    env: RoomsNavigation,
    table: Configurations,
    sampler: Sampler,
    settings: ApexSettings = ApexSettings(),
    axis_name: str | None = None,
) -> Agent:
    """An Ape-X agent that flies configurations of `table` as `sampler` draws them.

    Actors and learner take turns: every `fragment` steps come `updates` updates, and so an actor
    always acts by the newest parameters, where Horgan et al.'s run side by side.

    Args:
        axis_name: the mesh axis it will be sharded over (see `agents.agent.shard`), None for one
            device; the devices must divide the replay's shards.

    Raises:
        InputError: settings that do not fit one another.
    """
    settings.check()
    camera = env.scene.camera
    shape = (camera.height, camera.width)
    network = QNetwork(settings.network, env.action_size)
    optimizer = make_optimizer(settings)
    num_envs, n_step, num_shards = settings.num_envs, settings.n_step, settings.replay.num_shards
    num_rounds = settings.num_steps // settings.fragment

    def features(frame: Frame) -> jax.Array:
        return encode(expand(frame, shape, camera.far), camera.far)

    def empty_shards() -> Replay:
        one = replay.empty(settings.num_rows, settings.shard_envs, camera.height * camera.width)
        return jax.tree.map(lambda leaf: jnp.zeros((num_shards, *leaf.shape), leaf.dtype), one)

    def init(key: jax.Array, numbers: Mapping[str, jax.Array] | None = None) -> TrainState:
        key, key_online, key_target, key_fleet = jax.random.split(key, 4)
        sampler_state = sampler.init(**(numbers or {}))
        fleet = init_rollout(env, table, sampler, sampler_state, key_fleet, num_envs)
        seen = features(compress(observation(fleet.state), camera.far))[:1]
        params, target = network.init(key_online, seen), network.init(key_target, seen)
        zero = jnp.zeros((), jnp.int32)
        learner = Learner(params, target, optimizer.init(params), zero, zero, zero)
        nothing = jnp.zeros((num_envs, n_step))
        recent = Recent(nothing.astype(jnp.int32), nothing, nothing, nothing, nothing.astype(bool))
        return TrainState(learner, sampler_state, Actors(fleet, recent, empty_shards()), key)

    def iterate(state: TrainState) -> tuple[TrainState, Metrics]:
        key, key_rounds = jax.random.split(state.key)
        env_ids = global_ids(state.fleet.fleet.config_id.shape[0], axis_name)

        def fly(learner: Learner, actors: Actors, key: jax.Array) -> tuple[Actors, Episodes]:
            def act(obs: Any, chance: jax.Array) -> tuple[jax.Array, tuple]:
                frame = compress(obs, camera.far)
                seen = features(frame)
                q = action_values(network, learner.params, seen)
                q_target = action_values(network, learner.target, seen)
                action = explore(q, exploration(settings, env_ids), chance)
                taken = jnp.take_along_axis(q, action[..., None], axis=-1)[..., 0]
                return action, (frame, taken, double_value(q, q_target))

            fleet, trajectory, episodes = rollout(
                env,
                table,
                sampler,
                state.sampler,
                act,
                actors.fleet,
                key,
                env_ids,
                settings.fragment,
            )
            recent, rows = complete(settings, actors.recent, trajectory)
            shards = jax.vmap(lambda shard, rows: replay.add(settings.replay, shard, rows, n_step))(
                actors.shards, by_shard(rows, settings.shard_envs)
            )
            return Actors(fleet, recent, shards), episodes

        def round_(carry: tuple[Learner, Actors], key: jax.Array) -> tuple[tuple[Learner, Actors], tuple]:
            learner, actors = carry
            key_fly, key_learn = jax.random.split(key)
            actors, episodes = fly(learner, actors, key_fly)
            learner = learner._replace(sampled=count_on(learner.sampled, settings.fragment * num_envs))

            def learn(learner: Learner, shards: Replay) -> tuple[Learner, Replay, dict[str, jax.Array]]:
                return update(network, optimizer, settings, features, learner, shards, key_learn, axis_name)

            def wait(learner: Learner, shards: Replay) -> tuple[Learner, Replay, dict[str, jax.Array]]:
                return learner, shards, dict.fromkeys(("loss", "td_error", "value"), jnp.zeros(()))

            # A replay of n rows or fewer holds no transition yet.
            warm = learner.sampled >= max(settings.learning_starts, (n_step + 1) * num_envs)
            learner, shards, terms = jax.lax.cond(warm, learn, wait, learner, actors.shards)
            return (learner, actors._replace(shards=shards)), (episodes, terms, warm)

        keys = jax.random.split(key_rounds, num_rounds)
        carry, (episodes, terms, warm) = jax.lax.scan(round_, (state.learner, state.fleet), keys)
        learner, actors = carry
        # Over the rounds that learnt; where none did there is no figure.
        losses = {name: term.sum() / warm.sum() for name, term in terms.items()}
        losses["updates"] = learner.updates
        # RLlib 0.8.5 reports the last third of its actors, rounded up (`agents/dqn/apex.py`).
        reported = env_ids % settings.num_actors >= settings.num_actors + (-settings.num_actors // 3)
        sampler_state = sampler.update(state.sampler, episodes.outcomes, axis_name)
        parts = terms | {"parameters": learner.params, "physics": actors.fleet.state.pipeline_state}
        metrics = summarize(episodes, are_finite(parts, axis_name), losses, table.size, axis_name, reported)
        return TrainState(learner, sampler_state, actors, key), metrics

    def policy(learner: Learner, greedy: bool = False):
        def act(obs: Any, key: jax.Array) -> jax.Array:
            values = action_values(network, learner.params, features(compress(obs, camera.far)))
            if greedy:
                return jnp.argmax(values)
            # As in training: any of the actors.
            key_actor, key = jax.random.split(key)
            actor = jax.random.randint(key_actor, (), 0, settings.num_actors)
            return explore(values, exploration(settings, actor), jax.random.uniform(key))

        return act

    leaves = jax.tree.leaves(jax.eval_shape(empty_shards))
    replay_bytes = sum(leaf.size * leaf.dtype.itemsize for leaf in leaves)
    return Agent(init, iterate, policy, num_envs * settings.num_steps, replay_bytes)


def complete(settings: ApexSettings, recent: Recent, trajectory: Trajectory) -> tuple[Recent, Rows]:
    """The transitions that a fragment completes, with their |TD errors|; leaves (K, B, …).

    The n steps that it leaves incomplete are kept for the next.
    """
    frame, value, ahead = trajectory.extras
    new = Recent(
        trajectory.action,
        trajectory.reward * settings.reward_scale,
        trajectory.done,
        value,
        jnp.ones_like(trajectory.action, dtype=bool),
    )
    steps = jax.tree.map(lambda old, now: jnp.concatenate([old.T.astype(now.dtype), now]), recent, new)
    number = trajectory.action.shape[0]
    reward, discount = n_step_return(steps.reward[:-1], steps.done[:-1], settings.n_step, settings.discount)
    error = jnp.abs(reward + discount * ahead - steps.value[:number])
    error = jnp.where(steps.known[:number], error, -1.0)
    rows = Rows(frame, steps.action[:number], reward, discount, error)
    return jax.tree.map(lambda leaf: leaf[number:].T, steps), rows


def by_shard(rows: Rows, shard_envs: int) -> Rows:
    """Cuts (K, B, …) into shards (S, K, E, …)."""

    def cut(leaf: jax.Array) -> jax.Array:
        return jnp.moveaxis(leaf.reshape(leaf.shape[0], -1, shard_envs, *leaf.shape[2:]), 1, 0)

    return jax.tree.map(cut, rows)
