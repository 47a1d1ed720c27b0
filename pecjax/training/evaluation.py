"""Evaluation: a policy flown over a fixed, even draw of the configurations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pecjax.agents.agent import AXIS, Agent
from pecjax.agents.rollout import env_keys
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.navigation import RoomsNavigation, flight_state


class EvalResult(NamedTuple):
    """E flown episodes.

    Attributes:
        config_id: (E,) int.
        goal: (E,) bool, whether the goal was reached.
        returns: (E,) sum of rewards.
        lengths: (E,) int, actions taken.
        paths: (E, T + 1, 2) m, positions seen from above; past its end a path stands still.
    """

    config_id: Any
    goal: Any
    returns: Any
    lengths: Any
    paths: Any


def stratified_config_ids(num_configs: int, episodes: int, seed: int) -> np.ndarray:
    """E configuration numbers, every configuration as often as any other.

    What remains when N does not divide E goes to different configurations, drawn at random.
    """
    rest = np.random.default_rng(seed).permutation(num_configs)[: episodes % num_configs]
    return np.concatenate([np.tile(np.arange(num_configs), episodes // num_configs), rest]).astype(np.int32)


def make_flyer(
    env: RoomsNavigation, table: Configurations, agent: Agent, *, greedy: bool, seed: int
) -> Callable[[Any, jax.Array, jax.Array], EvalResult]:
    """Sets the conditions under which policies can be compared.

    Its `fly` takes a learner and, for each of E episodes, configuration and number, and returns
    `EvalResult`; it can be jitted, vmapped over learners and sharded over episodes.

    Args:
        greedy: takes the likeliest action at every step; else draws, as training does.
        seed: of headings and drawn actions: two policies with one seed fly the same episodes.
    """

    def fly(learner: Any, config_id: jax.Array, episode: jax.Array) -> EvalResult:
        keys = env_keys(jax.random.key(seed), episode)
        headings = jax.vmap(lambda k: jax.random.uniform(k, minval=-jnp.pi, maxval=jnp.pi))(keys)
        rows = jax.tree.map(lambda leaf: jnp.asarray(leaf)[config_id], table)
        return run_episodes(env, agent.policy(learner, greedy), rows, headings, keys, config_id)

    return fly


def make_evaluator(
    env: RoomsNavigation,
    table: Configurations,
    agent: Agent,
    mesh: Mesh,
    *,
    episodes: int,
    greedy: bool,
    seed: int,
) -> Callable[[Any], Callable[[Any], EvalResult]]:
    """Sets E episodes, an even draw, shared by the mesh's devices.

    Its `compile` takes a learner (arrays or their shapes) and returns fly(learner) -> `EvalResult` of
    numpy arrays.

    Args:
        greedy, seed: of `make_flyer`.
    """
    devices = mesh.devices.size
    config_id = stratified_config_ids(table.size, episodes, seed)
    padded = np.resize(config_id, -(-episodes // devices) * devices)
    spread = PartitionSpec(AXIS)
    program = jax.jit(
        jax.shard_map(
            make_flyer(env, table, agent, greedy=greedy, seed=seed),
            mesh=mesh,
            in_specs=(PartitionSpec(), spread, spread),
            out_specs=spread,
            check_vma=False,
        ),
        out_shardings=NamedSharding(mesh, PartitionSpec()),  # each process has all of them
    )

    def compile_for(learner: Any) -> Callable[[Any], EvalResult]:
        numbers = np.arange(padded.size, dtype=np.int32)
        compiled = program.lower(learner, padded, numbers).compile()

        def evaluate(learner: Any) -> EvalResult:
            flights = compiled(learner, padded, numbers)
            return EvalResult(*(np.asarray(leaf)[:episodes] for leaf in flights))

        return evaluate

    return compile_for


def run_episodes(
    env: RoomsNavigation,
    act: Callable[[Any, jax.Array], jax.Array],
    configs: Configurations,
    headings: jax.Array,
    keys: jax.Array,
    config_id: jax.Array,
) -> EvalResult:
    """Flies one episode per row of `configs`, all side by side, until the last has ended."""
    limit = env.settings.max_steps
    start = jax.vmap(env.observe)(jax.vmap(env.place)(configs, headings))
    number = headings.shape[0]
    paths = jnp.zeros((limit + 1, number, 2)).at[0].set(configs.start)

    def running(carry: tuple) -> jax.Array:
        time, state, *_ = carry
        return (time < limit) & jnp.any(state.done == 0)

    def step(carry: tuple) -> tuple:
        time, state, returns, paths = carry
        actions = jax.vmap(act)(state.obs, jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, time))
        flown = jax.vmap(env.step)(state, actions)
        over = state.done.astype(bool)

        def keep(old: jax.Array, new: jax.Array) -> jax.Array:
            return jnp.where(over.reshape(-1, *[1] * (old.ndim - 1)), old, new)

        returns = returns + jnp.where(over, 0.0, flown.reward)
        state = jax.tree.map(keep, state, flown)
        return time + 1, state, returns, paths.at[time + 1].set(flight_state(state).qpos[:, :2])

    time, state, returns, paths = jax.lax.while_loop(running, step, (0, start, jnp.zeros(number), paths))
    last = flight_state(state).qpos[:, :2]
    paths = jnp.where(jnp.arange(limit + 1)[:, None, None] > time, last, paths)
    return EvalResult(
        config_id, state.metrics["goal"] > 0, returns, flight_state(state).step_count, paths.swapaxes(0, 1)
    )


def goal_ratios(flights: EvalResult, num_configs: int) -> np.ndarray:
    """Goal ratio (N,) of each configuration, NaN where none of its episodes were flown."""
    flown = np.bincount(flights.config_id, minlength=num_configs)
    reached = np.bincount(flights.config_id, weights=flights.goal, minlength=num_configs)
    return np.where(flown > 0, reached / np.maximum(flown, 1), np.nan)
