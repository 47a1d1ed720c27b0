"""Replay: transitions kept on the device and drawn again by priority (Schaul et al. 2016)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.agents.apex import sum_tree


@dataclass(frozen=True)
class ReplaySettings:
    """Settings of the replay; the defaults are those of Ape-X (Horgan et al. 2018, §4.1).

    Attributes:
        capacity: transitions, over all shards.
        num_shards: parts that the replay is cut into by environment, each with a tree of its own
            from which an equal share of every batch is drawn, as in RLlib 0.8.5. What is drawn
            depends on them, and so not on the devices that they are spread over.
        alpha: α, how far priorities matter: P ∝ pᵅ.
        beta: β of the importance weights.
        epsilon: added to the absolute TD error to make a priority.
        stratified: see `sum_tree.draw`.
        normalize: what importance weights are divided by: the greatest of the shard's part of the
            `batch`, or the greatest that any transition in the `shard` would have (RLlib 0.8.5;
            takes a pass over the whole tree).
    """

    capacity: int = 2**17
    num_shards: int = 4
    alpha: float = 0.6
    beta: float = 0.4
    epsilon: float = 1e-6
    stratified: bool = True
    normalize: Literal["batch", "shard"] = "batch"


Packed = tuple[jax.Array, ...]  # observations as they are kept (see `observations.pack`): (…, n) each


class Rows(NamedTuple):
    """What is written at once: K rows of a shard's E environments, leaves (K, E, …).

    Each row holds an observation and the transition that led to it from the observation n rows
    before, in the same environment.

    Attributes:
        obs: the observation, packed.
        action: taken n rows before.
        reward: the n-step return from there.
        discount: of the value of this row's observation, 0 where the episode had ended.
        error: |TD error| of the transition, negative where there is none to draw.
    """

    obs: Packed
    action: jax.Array
    reward: jax.Array
    discount: jax.Array
    error: jax.Array


class Replay(NamedTuple):
    """One shard: a ring of T rows of E environments.

    Attributes:
        rows: leaves (T·E, …), row by row; without `error`, which the tree holds as priorities.
        tree: sum tree over T·E leaves.
        head: () int32, the row to be written next.
    """

    rows: tuple[Packed, jax.Array, jax.Array, jax.Array]
    tree: jax.Array
    head: jax.Array


class Batch(NamedTuple):
    """M transitions drawn: leaves (M, …).

    Attributes:
        leaf: where each lies.
        obs, next_obs: observations s_t and s_{t+n}.
        weight: importance weights, at most 1.
    """

    leaf: jax.Array
    obs: Packed
    action: jax.Array
    reward: jax.Array
    discount: jax.Array
    next_obs: Packed
    weight: jax.Array


def empty(num_rows: int, num_envs: int, like: Packed) -> Replay:
    """A shard of T rows of E environments with nothing in it.

    Args:
        like: packed observations (…, n), or their shapes.
    """
    size = num_rows * num_envs
    obs = tuple(jnp.zeros((size, part.shape[-1]), part.dtype) for part in like)
    rows = (obs, jnp.zeros(size, jnp.int32), jnp.zeros(size), jnp.zeros(size))
    return Replay(rows, sum_tree.empty(size), jnp.zeros((), jnp.int32))


def add(settings: ReplaySettings, replay: Replay, rows: Rows, n_step: int) -> Replay:
    """Writes K rows over the oldest; K divides T, and n_step is less than T - K."""
    steps, num_envs = rows.action.shape
    size = replay.rows[1].shape[0]
    first = replay.head * num_envs
    flat = jax.tree.map(lambda new: new.reshape(steps * num_envs, *new.shape[2:]), rows)

    def write(old: jax.Array, new: jax.Array) -> jax.Array:
        return jax.lax.dynamic_update_slice_in_dim(old, new, first, axis=0)

    kept = jax.tree.map(write, replay.rows, tuple(flat[:-1]))
    # The oldest rows now begin where it was overwritten: they lead from nowhere.
    stale = steps * num_envs + jnp.arange(n_step * num_envs)
    leaves = (first + jnp.concatenate([jnp.arange(steps * num_envs), stale])) % size
    priority = jnp.concatenate([_priority(settings, flat.error), jnp.zeros(stale.size)])
    tree = sum_tree.set_leaves(replay.tree, leaves, priority)
    return Replay(kept, tree, (replay.head + steps) % (size // num_envs))


def _priority(settings: ReplaySettings, error: jax.Array) -> jax.Array:
    known = error >= 0
    return jnp.where(known, (jnp.where(known, error, 0.0) + settings.epsilon) ** settings.alpha, 0.0)


def sample(
    settings: ReplaySettings, replay: Replay, key: jax.Array, number: int, num_envs: int, n_step: int
) -> Batch:
    """Draws `number` transitions, with weights (P / P_least)^−β (Schaul et al. 2016, §3.4)."""
    leaf = sum_tree.draw(replay.tree, key, number, settings.stratified)
    priority = sum_tree.get_leaves(replay.tree, leaf)
    if settings.normalize == "batch":
        least = priority.min()
    else:
        leaves = replay.tree[replay.tree.size // 2 :]
        least = jnp.where(leaves > 0, leaves, jnp.inf).min()
    obs, action, reward, discount = replay.rows
    before = (leaf - n_step * num_envs) % action.shape[0]
    return Batch(
        leaf,
        jax.tree.map(lambda kept: kept[before], obs),
        action[leaf],
        reward[leaf],
        discount[leaf],
        jax.tree.map(lambda kept: kept[leaf], obs),
        (priority / least) ** -settings.beta,
    )


def reprioritize(settings: ReplaySettings, replay: Replay, leaf: jax.Array, error: jax.Array) -> Replay:
    """Gives transitions the priorities of their new |TD errors| (M,)."""
    return replay._replace(tree=sum_tree.set_leaves(replay.tree, leaf, _priority(settings, error)))
