"""PPO: one iteration as one program."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from pecjax.agents.base import Agent, TrainState
from pecjax.agents.distributions import make_distribution
from pecjax.agents.episodes import add_counts, no_counts, sum_over_episodes
from pecjax.agents.metrics import Metrics, are_finite, summarize
from pecjax.agents.networks import ActorCritic, decide, forward
from pecjax.agents.observations import encode, flatten, image_shapes, in_order, num_values
from pecjax.agents.ppo.settings import PPO
from pecjax.agents.ppo.signals import step_signal
from pecjax.agents.ppo.update import Flown, Learner, make_optimizer, prepare, update
from pecjax.agents.rollout import Policy, Seen, init_rollout, rollout, see
from pecjax.agents.sharding import global_ids
from pecjax.curriculum.base import Sampler
from pecjax.curriculum.diagnostics import diagnose
from pecjax.envs.task import Task, World, num_configs
from pecjax.errors import InputError


def make_network(task: Task, settings: PPO) -> ActorCritic:
    """The networks that fit the task; `Learner.params` are their parameters.

    Raises:
        InputError: they do not fit.
    """
    shapes = image_shapes(task.observation_space)
    if settings.network.encoder == "cnn" and not shapes:
        raise InputError("the encoder cnn needs an image among the observations; choose mlp")
    is_privileged = settings.network.critic != "observation" and task.privileged_space is not None
    outputs, told = make_distribution(task.action_space).num_params, auxiliary_space(task, settings)
    return ActorCritic(
        settings.network, outputs, shapes, is_privileged, 0 if told is None else num_values(told)
    )


def auxiliary_space(task: Task, settings: PPO) -> Any:
    """Of what the actor predicts, see `PPO.auxiliary`; None where that is nothing.

    Raises:
        InputError: the task tells critics nothing of that name.
    """
    if settings.auxiliary is None:
        return None
    parts = task.privileged_space if isinstance(task.privileged_space, Mapping) else {}
    if settings.auxiliary not in parts:
        raise InputError(
            f"auxiliary is {settings.auxiliary}, and this task tells critics of "
            f"{' and '.join(parts) or 'nothing'}; give one of these, path wants --task.critic-paths"
        )
    return parts[settings.auxiliary]


def critic_features(task: Task, seen: Seen, critic: str) -> jax.Array:
    """What a privileged critic reads, (…, K), see `NetworkSettings`: what it is told, and of what is seen."""
    parts = [encode(task.privileged_space, seen.privileged)]
    leaves = jax.tree.leaves(seen.obs)
    for box, place in in_order(task.observation_space):
        leaf = leaves[place]
        if not box.is_image:
            parts.append(flatten(box, leaf))
        elif critic == "privileged_row":
            row = jnp.take(leaf, box.shape[0] // 2, axis=-len(box.shape))
            parts.append(row.reshape(*leaf.shape[: -len(box.shape)], -1))
    return jnp.concatenate(parts, axis=-1)


def make(task: Task, sampler: Sampler, settings: PPO, axis_name: str | None = None) -> Agent:
    """See `AgentSettings.make`."""
    settings.check()
    space = task.observation_space
    distribution = make_distribution(task.action_space)
    network, told = make_network(task, settings), auxiliary_space(task, settings)
    optimizer = make_optimizer(settings)

    first_memory = settings.network.first_memory()

    def read(seen: Seen) -> tuple[jax.Array, jax.Array | None, jax.Array | None]:
        """The actor's features, the critic's where it has its own, and the memory where there is one."""
        known = critic_features(task, seen, settings.network.critic) if network.is_privileged else None
        return encode(space, seen.obs), known, seen.memory

    def to_predict(seen: Seen) -> jax.Array | None:
        return None if told is None else encode(told, seen.privileged[settings.auxiliary])

    def init(key: jax.Array, world: World, numbers: Mapping[str, jax.Array] | None = None) -> TrainState:
        key, key_params, key_envs = jax.random.split(key, 3)
        sampler_state = sampler.init(**(numbers or {}))
        envs = init_rollout(task, world, sampler, sampler_state, key_envs, settings.num_envs, first_memory)
        features, known, memory = jax.tree.map(lambda leaf: leaf[:1], read(see(task, world, envs)))
        params = network.init(key_params, features, known, memory=memory)
        kl_coeff = jnp.asarray(settings.kl_coeff or 0.0, jnp.float32)
        learner = Learner(params, optimizer.init(params), kl_coeff)
        counts = no_counts(num_configs(world.table))
        return TrainState(learner, sampler_state, counts, envs, key)

    def iterate(state: TrainState, world: World) -> tuple[TrainState, Metrics]:
        learner = state.learner
        key, key_rollout, key_update = jax.random.split(state.key, 3)

        def act(seen: Seen, noise: jax.Array) -> tuple[jax.Array, jax.Array | None, tuple]:
            features, known, memory = read(seen)
            params, value, after, _ = forward(network, learner.params, features, known, memory=memory)
            drawn = distribution.draw(params, noise)
            if settings.network.precision == "bfloat16":
                features = features.astype(jnp.bfloat16)  # as the products take them
            flown = Flown(features, known, drawn, params, value, to_predict(seen))
            return distribution.action(drawn), after, flown

        def value(seen: Seen) -> jax.Array:
            features, known, memory = read(seen)
            return forward(network, learner.params, features, known, memory=memory).value

        envs, trajectory, episodes = rollout(
            task,
            world,
            sampler,
            state.sampler,
            Policy(distribution.noise, act, value, first_memory),
            state.envs,
            key_rollout,
            global_ids(state.envs.running.length.shape[0], axis_name),
            settings.num_steps,
            settings.steps_of_a_sequence if settings.has_memory else None,
        )
        last_value = value(see(task, world, envs))
        batch = prepare(settings, distribution, trajectory, last_value, axis_name)
        learner, losses = update(
            network, distribution, optimizer, settings, learner, batch, key_update, axis_name
        )
        scores = step_signal(settings, trajectory, batch, last_value)
        sums, left = sum_over_episodes(state.envs.running.score, scores, trajectory.done)
        envs = envs._replace(running=envs.running._replace(score=left))
        outcomes = episodes.outcomes._replace(signal=sums / episodes.outcomes.length)
        sampler_state = sampler.update(state.sampler, outcomes, axis_name)
        counts = add_counts(state.counts, episodes.outcomes, axis_name)
        spread = diagnose(sampler.probabilities(sampler_state), counts[:2])
        finite = are_finite(losses | {"parameters": learner.params, "observations": envs.obs}, axis_name)
        metrics = summarize(episodes, finite, losses, spread, axis_name)
        return TrainState(learner, sampler_state, counts, envs, key), metrics

    def policy(learner: Learner, greedy: bool = False):
        def act(obs: Any, key: jax.Array, memory: jax.Array | None = None) -> Any:
            out = decide(network, learner.params, encode(space, obs), memory)
            drawn = (
                distribution.mode(out.params)
                if greedy
                else distribution.draw(out.params, distribution.noise(key))
            )
            action = distribution.action(drawn)
            return action if first_memory is None else (action, out.memory)

        return act

    batch = settings.num_envs * settings.num_steps
    return Agent(init, iterate, policy, batch, first_memory=first_memory)
