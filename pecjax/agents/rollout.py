"""Rollout: where the loop closes: configurations are drawn, flown, scored and reported."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.navigation import RoomsNavigation, State, flight_state

# (observations (B, …), chance (B,)) -> actions (B,) and whatever else the agent wants recorded;
# chance is uniform in [0, 1), all the randomness that an action may have
Act = Callable[[Any, jax.Array], tuple[jax.Array, Any]]


class RolloutState(NamedTuple):
    """The environments that an agent keeps running from batch to batch.

    Attributes:
        state: their Brax states, leading axis B.
        config_id: (B,) int32, the configuration each running episode was reset with.
        episode_return: (B,), rewards of the running episode so far.
    """

    state: State
    config_id: jax.Array
    episode_return: jax.Array


class Trajectory(NamedTuple):
    """What was seen and done, every leaf with leading axes (T, B).

    Attributes:
        obs: the observation before the action.
        action, reward, done: as of `env.step`.
        extras: what the policy reported with the action.
    """

    obs: Any
    action: jax.Array
    reward: jax.Array
    done: jax.Array
    extras: Any


class Episodes(NamedTuple):
    """The endings within a rollout, arrays (T, B) that count where `outcomes.done` is 1.

    Attributes:
        outcomes: what the sampler learns from.
        returns: sum of rewards of the episode.
        lengths: its number of actions.
        unstable: bool, whether its physics blew up.
    """

    outcomes: Outcomes
    returns: jax.Array
    lengths: jax.Array
    unstable: jax.Array


def env_keys(key: jax.Array, env_ids: jax.Array) -> jax.Array:
    """One key per environment, by its global number, so that sharding does not change draws."""
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, env_ids)


def global_ids(num_local: int, axis_name: str | None) -> jax.Array:
    """The global numbers of what this device holds of something spread over the mesh axis."""
    first = 0 if axis_name is None else jax.lax.axis_index(axis_name) * num_local
    return first + jnp.arange(num_local)


def draw_episodes(
    sampler: Sampler, sampler_state: Any, keys: jax.Array, num_draws: int
) -> tuple[jax.Array, jax.Array]:
    """Configuration numbers and headings (rad), (num_draws, B), for the episodes to come."""

    def of_one(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        key_id, key_heading = jax.random.split(key)
        headings = jax.random.uniform(key_heading, (num_draws,), minval=-jnp.pi, maxval=jnp.pi)
        return sampler.sample(sampler_state, key_id, (num_draws,)), headings

    return jax.vmap(of_one, out_axes=1)(keys)


def _place(env: RoomsNavigation, table: Configurations, config_id: jax.Array, heading: jax.Array) -> State:
    rows = jax.tree.map(lambda leaf: jnp.asarray(leaf)[config_id], table)
    return jax.vmap(env.place)(rows, heading)


def init_rollout(
    env: RoomsNavigation,
    table: Configurations,
    sampler: Sampler,
    sampler_state: Any,
    key: jax.Array,
    num_envs: int,
) -> RolloutState:
    """Starts B environments in configurations drawn from the sampler."""
    keys = env_keys(key, jnp.arange(num_envs))
    ids, headings = draw_episodes(sampler, sampler_state, keys, 1)
    state = jax.vmap(env.observe)(_place(env, table, ids[0], headings[0]))
    return RolloutState(state, ids[0], jnp.zeros(num_envs))


def rollout(
    env: RoomsNavigation,
    table: Configurations,
    sampler: Sampler,
    sampler_state: Any,
    act: Act,
    fleet: RolloutState,
    key: jax.Array,
    env_ids: jax.Array,
    num_steps: int,
) -> tuple[RolloutState, Trajectory, Episodes]:
    """Flies every environment for T steps (Jang & Choi 2022, Fig. 1, lines 2-10).

    An episode that ends gives way at once to the next, drawn from the sampler as it stands at the
    beginning of the batch; one that is still running is carried into the next batch. An outcome
    is reported when its episode ends, for the configuration the episode was reset with.

    Args:
        env_ids: (B,), the environments' global numbers: all randomness is keyed by them.
    """
    key_draw, key_act = jax.random.split(key)
    draws = draw_episodes(sampler, sampler_state, env_keys(key_draw, env_ids), num_steps)
    chances = jax.vmap(lambda k: jax.random.uniform(k, (num_steps,)), out_axes=1)(env_keys(key_act, env_ids))

    def step(fleet: RolloutState, row: tuple) -> tuple[RolloutState, tuple[Trajectory, Episodes]]:
        (next_id, next_heading), chance = row
        action, extras = act(fleet.state.obs, chance)
        flown = jax.vmap(env.advance)(fleet.state, action)
        done = flown.done.astype(bool)
        episode_return = fleet.episode_return + flown.reward
        episodes = Episodes(
            Outcomes(fleet.config_id, done, done & (flown.metrics["goal"] == 0)),
            episode_return,
            flight_state(flown).step_count,
            flown.metrics["unstable"] > 0,
        )
        trajectory = Trajectory(fleet.state.obs, action, flown.reward, flown.done, extras)

        def where_done(new: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where(done.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        # The old observation is of no more use; one depth image a step is cast, of what stands now.
        fresh = _place(env, table, next_id, next_heading)
        state = jax.tree.map(where_done, fresh, flown.replace(obs={}))
        fleet = RolloutState(
            state=jax.vmap(env.observe)(state),
            config_id=where_done(next_id, fleet.config_id),
            episode_return=where_done(jnp.zeros_like(episode_return), episode_return),
        )
        return fleet, (trajectory, episodes)

    fleet, (trajectory, episodes) = jax.lax.scan(step, fleet, (draws, chances))
    return fleet, trajectory, episodes
