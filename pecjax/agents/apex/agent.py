"""Ape-X DQN: one iteration as one program."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.agents.apex import replay
from pecjax.agents.apex.q_network import QNetwork, action_values
from pecjax.agents.apex.replay import Packed, Replay, Rows
from pecjax.agents.apex.settings import Apex
from pecjax.agents.apex.update import Learner, double_value, make_optimizer, update
from pecjax.agents.base import Agent, TrainState
from pecjax.agents.episodes import Episodes, add_counts, count_on, no_counts
from pecjax.agents.metrics import Metrics, are_finite, summarize
from pecjax.agents.observations import pack, unpack
from pecjax.agents.returns import n_step_return, with_bootstrap
from pecjax.agents.rollout import Policy, RolloutState, Seen, Trajectory, init_rollout, rollout
from pecjax.agents.sharding import global_ids
from pecjax.curriculum.base import Sampler
from pecjax.curriculum.diagnostics import diagnose
from pecjax.envs.spaces import Discrete
from pecjax.envs.task import Task, World, num_configs
from pecjax.errors import InputError


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

    envs: RolloutState
    recent: Recent
    shards: Replay


def exploration(settings: Apex, env_ids: jax.Array) -> jax.Array:
    """ε of each environment (Horgan et al. 2018, §4.1), actors dealt out in turn."""
    actor = env_ids % settings.num_actors
    return settings.epsilon ** (1 + settings.epsilon_exponent * actor / max(settings.num_actors - 1, 1))


def explore(values: jax.Array, epsilon: jax.Array, uniform: jax.Array) -> jax.Array:
    """ε-greedy actions (…,) for action values (…, A), from one uniform number each."""
    number = values.shape[-1]
    # Below ε the number is uniform in [0, ε), and says which action too.
    anything = jnp.minimum(uniform / epsilon * number, number - 1).astype(jnp.int32)
    return jnp.where(uniform < epsilon, anything, jnp.argmax(values, axis=-1).astype(jnp.int32))


def make_network(task: Task, settings: Apex) -> QNetwork:
    """The network that fits the task; `Learner.params` are its parameters.

    Raises:
        InputError: its actions are not discrete.
    """
    if not isinstance(task.action_space, Discrete):
        raise InputError(f"apex needs discrete actions, not {task.action_space}; choose the agent ppo")
    return QNetwork(settings.network, task.action_space.num_actions)


def make(task: Task, sampler: Sampler, settings: Apex, axis_name: str | None = None) -> Agent:
    """See `AgentSettings.make`.

    Actors and learner take turns: every `rollout_length` steps come `updates` updates, and so an actor
    always acts by the newest parameters, where Horgan et al.'s run side by side. Where a task truncates,
    the value that is bootstrapped from is the one estimated when the step was taken.
    """
    settings.check()
    space = task.observation_space
    network = make_network(task, settings)
    optimizer = make_optimizer(settings)
    num_envs, n_step, num_shards = settings.num_envs, settings.n_step, settings.replay.num_shards
    num_rounds = settings.num_steps // settings.rollout_length

    def features(packed: Packed) -> jax.Array:
        return unpack(space, packed)

    def empty_shards() -> Replay:
        seen = jax.eval_shape(lambda: pack(space, jax.tree.map(lambda box: jnp.zeros(box.shape), space)))
        one = replay.empty(settings.num_rows, settings.shard_envs, seen)
        return jax.tree.map(lambda leaf: jnp.zeros((num_shards, *leaf.shape), leaf.dtype), one)

    def init(key: jax.Array, world: World, numbers: Mapping[str, jax.Array] | None = None) -> TrainState:
        key, key_online, key_target, key_envs = jax.random.split(key, 4)
        sampler_state = sampler.init(**(numbers or {}))
        envs = init_rollout(task, world, sampler, sampler_state, key_envs, num_envs)
        seen = features(pack(space, envs.obs))[:1]
        params, target = network.init(key_online, seen), network.init(key_target, seen)
        zero = jnp.zeros((), jnp.int32)
        learner = Learner(params, target, optimizer.init(params), zero, zero, zero)
        nothing = jnp.zeros((num_envs, n_step))
        recent = Recent(nothing.astype(jnp.int32), nothing, nothing, nothing, nothing.astype(bool))
        counts = no_counts(num_configs(world.table))
        return TrainState(learner, sampler_state, counts, Actors(envs, recent, empty_shards()), key)

    def iterate(state: TrainState, world: World) -> tuple[TrainState, Metrics]:
        key, key_rounds = jax.random.split(state.key)
        env_ids = global_ids(state.envs.envs.running.length.shape[0], axis_name)

        def collect(learner: Learner, actors: Actors, key: jax.Array) -> tuple[Actors, Episodes]:
            def values(packed: Packed) -> tuple[jax.Array, jax.Array]:
                seen = features(packed)
                q = action_values(network, learner.params, seen)
                return q, double_value(q, action_values(network, learner.target, seen))

            def act(seen: Seen, uniform: jax.Array) -> tuple[jax.Array, None, tuple]:
                packed = pack(space, seen.obs)
                q, ahead = values(packed)
                action = explore(q, exploration(settings, env_ids), uniform)
                taken = jnp.take_along_axis(q, action[..., None], axis=-1)[..., 0]
                return action, None, (packed, taken, ahead)

            envs, trajectory, episodes = rollout(
                task,
                world,
                sampler,
                state.sampler,
                Policy(jax.random.uniform, act, lambda seen: values(pack(space, seen.obs))[1]),
                actors.envs,
                key,
                env_ids,
                settings.rollout_length,
            )
            recent, rows = complete(settings, actors.recent, trajectory)
            shards = jax.vmap(lambda shard, rows: replay.add(settings.replay, shard, rows, n_step))(
                actors.shards, by_shard(rows, settings.shard_envs)
            )
            return Actors(envs, recent, shards), episodes

        def round_(carry: tuple[Learner, Actors], key: jax.Array) -> tuple[tuple[Learner, Actors], tuple]:
            learner, actors = carry
            key_collect, key_learn = jax.random.split(key)
            actors, episodes = collect(learner, actors, key_collect)
            learner = learner._replace(sampled=count_on(learner.sampled, settings.rollout_length * num_envs))

            def learn(learner: Learner, shards: Replay) -> tuple[Learner, Replay, dict[str, jax.Array]]:
                return update(network, optimizer, settings, features, learner, shards, key_learn, axis_name)

            def wait(learner: Learner, shards: Replay) -> tuple[Learner, Replay, dict[str, jax.Array]]:
                of_none = jax.eval_shape(learn, learner, shards)[2]
                return learner, shards, jax.tree.map(lambda term: jnp.zeros(term.shape, term.dtype), of_none)

            # A replay of n rows or fewer holds no transition yet.
            warm = learner.sampled >= max(settings.learning_starts, (n_step + 1) * num_envs)
            learner, shards, terms = jax.lax.cond(warm, learn, wait, learner, actors.shards)
            return (learner, actors._replace(shards=shards)), (episodes, terms, warm)

        keys = jax.random.split(key_rounds, num_rounds)
        carry, (episodes, terms, warm) = jax.lax.scan(round_, (state.learner, state.envs), keys)
        learner, actors = carry
        # Over the rounds that learnt; where none did there is no figure.
        losses = {name: term.sum() / warm.sum() for name, term in terms.items()}
        losses["updates"] = learner.updates
        # RLlib 0.8.5 reports the last third of its actors, rounded up (`agents/dqn/apex.py`).
        reported = env_ids % settings.num_actors >= settings.num_actors + (-settings.num_actors // 3)
        sampler_state = sampler.update(state.sampler, episodes.outcomes, axis_name)
        counts = add_counts(state.counts, episodes.outcomes, axis_name)
        spread = diagnose(sampler.probabilities(sampler_state), counts[:2])
        parts = terms | {"parameters": learner.params, "observations": actors.envs.obs}
        metrics = summarize(episodes, are_finite(parts, axis_name), losses, spread, axis_name, reported)
        return TrainState(learner, sampler_state, counts, actors, key), metrics

    def policy(learner: Learner, greedy: bool = False):
        def act(obs: Any, key: jax.Array) -> jax.Array:
            values = action_values(network, learner.params, features(pack(space, obs)))
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


def complete(settings: Apex, recent: Recent, trajectory: Trajectory) -> tuple[Recent, Rows]:
    """The transitions that a rollout completes, with their |TD errors|; leaves (K, B, …).

    The n steps that it leaves incomplete are kept for the next.
    """
    packed, value, ahead = trajectory.extras
    new = Recent(
        trajectory.action,
        with_bootstrap(trajectory.reward * settings.reward_scale, trajectory.bootstrap, settings.discount),
        trajectory.done,
        value,
        jnp.ones_like(trajectory.action, dtype=bool),
    )
    steps = jax.tree.map(lambda old, now: jnp.concatenate([old.T.astype(now.dtype), now]), recent, new)
    number = trajectory.action.shape[0]
    reward, discount = n_step_return(steps.reward[:-1], steps.done[:-1], settings.n_step, settings.discount)
    error = jnp.abs(reward + discount * ahead - steps.value[:number])
    error = jnp.where(steps.known[:number], error, -1.0)
    rows = Rows(packed, steps.action[:number], reward, discount, error)
    return jax.tree.map(lambda leaf: leaf[number:].T, steps), rows


def by_shard(rows: Rows, shard_envs: int) -> Rows:
    """Cuts (K, B, …) into shards (S, K, E, …)."""

    def cut(leaf: jax.Array) -> jax.Array:
        return jnp.moveaxis(leaf.reshape(leaf.shape[0], -1, shard_envs, *leaf.shape[2:]), 1, 0)

    return jax.tree.map(cut, rows)
