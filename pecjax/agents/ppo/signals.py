"""Signals: PPO's score of every step of an episode, for samplers."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pecjax.agents.ppo.settings import PPO
from pecjax.agents.ppo.update import Batch, scaled_reward
from pecjax.agents.returns import maximised_negative_advantage, td_errors
from pecjax.agents.rollout import Trajectory


def step_signal(settings: PPO, trajectory: Trajectory, batch: Batch, last_value: jax.Array) -> jax.Array:
    """The signal of every step (T, B), in units of the reward.

    The value losses are those of Jiang et al. 2021, "Prioritized level replay", the positive one and the
    value those of "Replay-guided adversarial environment design".

    Args:
        batch: of this trajectory.
        last_value: (B,), the value of the state after it.
    """
    advantage, value = batch.target - batch.value, batch.value
    match settings.signal:
        case "positive_value_loss":
            found = jnp.maximum(advantage, 0.0)
        case "negative_value_loss":
            found = jnp.maximum(-advantage, 0.0)
        case "value_loss":
            found = jnp.abs(advantage)
        case "maximised_negative_advantage":
            reward, done = scaled_reward(settings, trajectory), trajectory.done
            errors = td_errors(reward, value, done, last_value, settings.discount)
            found = maximised_negative_advantage(errors, done, settings.discount, settings.gae_lambda)
        case "value":
            found = value
    return found / settings.reward_scale
