"""Rollout, where the loop closes: configurations are drawn, flown, scored and reported."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.agents.episodes import Episodes, Running, reset_where, start_episodes, step_episodes
from pecjax.agents.sharding import env_keys
from pecjax.curriculum.base import Sampler
from pecjax.envs.task import Task, World, take_configs


class Seen(NamedTuple):
    """What an agent is given of its environments, leading axis B.

    Attributes:
        obs: the observations.
        privileged: what only a critic may use, see `Task.privileged`; None of a task that gives nothing.
        memory: what the agent carries through the episode; None of an agent without memory.
    """

    obs: Any
    privileged: Any
    memory: Any = None


class Policy(NamedTuple):
    """How an agent acts in a rollout.

    Attributes:
        noise: (key) -> all the randomness that one action may have.
        act: (what is seen, noise (B, …)) -> (actions (B, …), the memory after the step, whatever else the
            agent wants recorded of it).
        value: (what is seen) -> (B,), what is bootstrapped from where a task truncates.
        first_memory: of one environment, where an episode begins; None of an agent without memory.
    """

    noise: Callable[[jax.Array], Any]
    act: Callable[[Seen, Any], tuple[jax.Array, Any, Any]]
    value: Callable[[Seen], jax.Array]
    first_memory: Any = None


class RolloutState(NamedTuple):
    """The environments that an agent keeps running from batch to batch, leading axis B.

    Attributes:
        state: of the task.
        obs: what each of them sees.
        running: their episodes.
        memory: of the agent, see `Seen`.
    """

    state: Any
    obs: Any
    running: Running
    memory: Any = None


class Trajectory(NamedTuple):
    """What was done, every leaf but the memory with leading axes (T, B).

    Attributes:
        obs: the observation before the action.
        action, reward: as of `Task.step`.
        done: float32, 1 where the episode ended.
        bootstrap: the value of what an episode that was cut off would have gone on to see, 0 elsewhere;
            None of a task that never truncates.
        extras: what the policy reported with the action.
        memory: (T / L, B, H), before each stretch of L steps; None of a policy without one.
    """

    obs: Any
    action: jax.Array
    reward: jax.Array
    done: jax.Array
    bootstrap: jax.Array | None
    extras: Any
    memory: Any = None


class _Draws(NamedTuple):
    """All that is drawn for a step, leading axes (T, B): what a step does not use costs nothing."""

    config_id: jax.Array
    noise: Any
    step: jax.Array
    reset: jax.Array
    observe: jax.Array
    last_look: jax.Array


def _draw(sampler: Sampler, sampler_state: Any, noise: Any, keys: jax.Array, num_steps: int) -> _Draws:
    def of_env(key: jax.Array) -> _Draws:
        key_id, key_noise, *others = jax.random.split(key, 6)
        ids = sampler.sample(sampler_state, key_id, (num_steps,))
        noises = jax.vmap(noise)(jax.random.split(key_noise, num_steps))
        return _Draws(ids, noises, *(jax.random.split(other, num_steps) for other in others))

    return jax.vmap(of_env, out_axes=1)(keys)


def init_rollout(
    task: Task,
    world: World,
    sampler: Sampler,
    sampler_state: Any,
    key: jax.Array,
    num_envs: int,
    first_memory: Any = None,
) -> RolloutState:
    """Starts B environments in configurations drawn from the sampler."""
    keys = env_keys(key, jnp.arange(num_envs))
    draws = jax.tree.map(lambda leaf: leaf[0], _draw(sampler, sampler_state, lambda key: (), keys, 1))
    state = _reset(task, world, draws)
    return RolloutState(
        state,
        _observe(task, world, draws.observe, state),
        start_episodes(draws.config_id, task.metrics),
        jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (num_envs, *leaf.shape)), first_memory),
    )


def _reset(task: Task, world: World, draws: _Draws) -> Any:
    configs = take_configs(world.table, draws.config_id)
    return jax.vmap(task.reset, in_axes=(0, 0, None))(draws.reset, configs, world.params)


def _observe(task: Task, world: World, keys: jax.Array, state: Any) -> Any:
    return jax.vmap(task.observe, in_axes=(0, 0, None))(keys, state, world.params)


def see(task: Task, world: World, envs: RolloutState) -> Seen:
    """What an agent is given of these environments."""
    if task.privileged_space is None:
        return Seen(envs.obs, None, envs.memory)
    privileged = jax.vmap(task.privileged, in_axes=(0, None))(envs.state, world.params)
    return Seen(envs.obs, privileged, envs.memory)


def rollout(
    task: Task,
    world: World,
    sampler: Sampler,
    sampler_state: Any,
    policy: Policy,
    envs: RolloutState,
    key: jax.Array,
    env_ids: jax.Array,
    num_steps: int,
    stretch: int | None = None,
) -> tuple[RolloutState, Trajectory, Episodes]:
    """Steps every environment T times (Jang & Choi 2022, Fig. 1, lines 2-10).

    An episode that ends is followed at once by the next, drawn from the sampler as it stands at the
    beginning of the batch; one that is still running is carried into the next batch. An outcome
    is reported when its episode ends, for the configuration the episode was reset with.

    Args:
        env_ids: (B,), the environments' global numbers: all randomness is keyed by them.
        stretch: L, which divides T; None for all T.
    """
    all_draws = _draw(sampler, sampler_state, policy.noise, env_keys(key, env_ids), num_steps)

    def step(envs: RolloutState, draws: _Draws) -> tuple[RolloutState, tuple[Trajectory, Episodes]]:
        action, memory, extras = policy.act(see(task, world, envs), draws.noise)
        after = jax.vmap(task.step, in_axes=(0, 0, 0, None))(draws.step, envs.state, action, world.params)
        running, episodes = step_episodes(envs.running, after, task.metrics)
        done = episodes.outcomes.done
        bootstrap = None
        if task.truncates:
            last_obs = _observe(task, world, draws.last_look, after.state)
            value = policy.value(see(task, world, RolloutState(after.state, last_obs, running, memory)))
            bootstrap = jnp.where(after.truncated & ~after.terminated, value, 0.0)
        trajectory = Trajectory(envs.obs, action, after.reward, jnp.float32(done), bootstrap, extras)
        # Observed once a step, what stands there now: the last sight of an episode is of no use.
        state = reset_where(done, _reset(task, world, draws), after.state)
        envs = RolloutState(
            state,
            _observe(task, world, draws.observe, state),
            reset_where(done, start_episodes(draws.config_id, task.metrics), running),
            reset_where(done, policy.first_memory, memory),
        )
        return envs, (trajectory, episodes)

    # A memory may be large, so it is kept where it is needed and not at every step.
    def fly(envs: RolloutState, draws: _Draws) -> tuple[RolloutState, tuple[Any, Any]]:
        after, flown = jax.lax.scan(step, envs, draws)
        return after, (envs.memory, flown)

    stretches = (-1, stretch or num_steps)
    draws = jax.tree.map(lambda leaf: leaf.reshape(*stretches, *leaf.shape[1:]), all_draws)
    envs, (memory, flown) = jax.lax.scan(fly, envs, draws)
    trajectory, episodes = jax.tree.map(lambda leaf: leaf.reshape(num_steps, *leaf.shape[2:]), flown)
    return envs, trajectory._replace(memory=memory), episodes
