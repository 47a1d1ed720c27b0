"""PPO: proximal policy optimisation (Schulman et al. 2017), one iteration as one program."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from pecjax.agents.agent import Agent, Metrics, TrainState, are_finite, summarize
from pecjax.agents.networks import ActorCritic, draw_action, encode, forward
from pecjax.agents.ppo_update import Learner, PPOSettings, make_optimizer, prepare, update
from pecjax.agents.rollout import global_ids, init_rollout, rollout
from pecjax.curriculum.base import Sampler
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.navigation import RoomsNavigation, observation


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
    settings.check()
    camera = env.scene.camera
    network = ActorCritic(settings.network, env.action_size, (camera.height, camera.width))
    optimizer = make_optimizer(settings)

    def init(key: jax.Array, numbers: Mapping[str, jax.Array] | None = None) -> TrainState:
        key, key_params, key_fleet = jax.random.split(key, 3)
        sampler_state = sampler.init(**(numbers or {}))
        fleet = init_rollout(env, table, sampler, sampler_state, key_fleet, settings.num_envs)
        params = network.init(key_params, encode(observation(fleet.state), camera.far)[:1])
        kl_coeff = jnp.asarray(settings.kl_coeff or 0.0, jnp.float32)
        return TrainState(Learner(params, optimizer.init(params), kl_coeff), sampler_state, fleet, key)

    def iterate(state: TrainState) -> tuple[TrainState, Metrics]:
        learner = state.learner
        key, key_rollout, key_update = jax.random.split(state.key, 3)

        def act(obs: Any, chance: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
            features = encode(obs, camera.far)
            logits, value = forward(network, learner.params, features)
            return draw_action(logits, chance), (features, logits, value)

        fleet, trajectory, episodes = rollout(
            env,
            table,
            sampler,
            state.sampler,
            act,
            state.fleet,
            key_rollout,
            global_ids(state.fleet.config_id.shape[0], axis_name),
            settings.num_steps,
        )
        _, last_value = forward(network, learner.params, encode(observation(fleet.state), camera.far))
        batch = prepare(settings, trajectory, last_value, axis_name)
        learner, losses = update(network, optimizer, settings, learner, batch, key_update, axis_name)
        sampler_state = sampler.update(state.sampler, episodes.outcomes, axis_name)
        parts = losses | {"parameters": learner.params, "physics": fleet.state.pipeline_state}
        metrics = summarize(episodes, are_finite(parts, axis_name), losses, table.size, axis_name)
        return TrainState(learner, sampler_state, fleet, key), metrics

    def policy(learner: Learner, greedy: bool = False):
        def act(obs: Any, key: jax.Array) -> jax.Array:
            logits, _ = forward(network, learner.params, encode(obs, camera.far))
            return jnp.argmax(logits) if greedy else draw_action(logits, jax.random.uniform(key))

        return act

    return Agent(init, iterate, policy, settings.num_envs * settings.num_steps)
