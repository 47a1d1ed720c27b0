"""Minibatches: the parts that a batch is learnt from, and the order in which the epochs take them."""

from __future__ import annotations

from typing import TypeVar

import jax
import jax.numpy as jnp

from pecjax.agents.ppo.settings import PPO
from pecjax.agents.sharding import global_ids

Tree = TypeVar("Tree")


def cut(settings: PPO, key: jax.Array, batch: Tree, axis_name: str | None) -> tuple[Tree, jax.Array]:
    """Minibatches of a batch (T, B, …), leaves (M, rows, …), and their numbers in the order of all epochs.

    They are gathered once and not once an epoch: they are the same in all of them. Of sequences, the rows
    are of each sequence's first step, of each one's second, and so on.

    Args:
        axis_name: of the devices over which B is spread; each takes its own part of every minibatch.
    """
    num_rows, num_envs = jax.tree.leaves(batch)[0].shape[:2]
    if settings.has_memory:
        envs, order = shuffle_envs(settings, key, global_ids(num_envs, axis_name))
        return jax.tree.map(lambda leaf: _in_sequences(settings, leaf, envs), batch), order
    if settings.shuffle == "samples":
        if axis_name is not None:
            batch = jax.lax.all_gather(batch, axis_name, axis=1, tiled=True)
        batch = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), batch)
        num_rows = jax.tree.leaves(batch)[0].shape[0]
    rows, order = shuffle(settings, key, num_rows)
    if settings.shuffle == "samples" and axis_name is not None:
        rows = _own_share(rows, axis_name)
    return jax.tree.map(lambda leaf: _in_rows(settings, leaf[rows]), batch), order


def shuffle(settings: PPO, key: jax.Array, num_rows: int) -> tuple[jax.Array, jax.Array]:
    """Row numbers (M, rows of each), and the minibatches' numbers in the order of all epochs.

    They are the same on every device.
    """
    once, order = _keys(settings, key)
    size = num_rows // settings.num_minibatches
    rows = jax.random.permutation(once, num_rows)[: settings.num_minibatches * size]
    return rows.reshape(-1, size), order


def shuffle_envs(settings: PPO, key: jax.Array, env_ids: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Places of environments (M, envs of each) among those given, and the order as of `shuffle`.

    Of every M environments in a row each minibatch has one, so that devices share each of them evenly.

    Args:
        env_ids: (B,), their global numbers; a device has whole groups of M.
    """
    once, order = _keys(settings, key)
    number = settings.num_minibatches
    keys = jax.vmap(lambda group: jax.random.fold_in(once, group))(env_ids[::number] // number)
    places = jax.vmap(lambda k: jax.random.permutation(k, number))(keys)
    return (places + number * jnp.arange(len(places))[:, None]).T, order


def _keys(settings: PPO, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """A key to cut by, and the minibatches' numbers in the order of all epochs."""
    once, *keys = jax.random.split(key, settings.num_epochs + 1)
    order = jax.vmap(lambda k: jax.random.permutation(k, settings.num_minibatches))(jnp.stack(keys))
    return once, order.reshape(-1)


def _in_rows(settings: PPO, leaf: jax.Array) -> jax.Array:
    """Minibatches (M, rows, …) of samples, of (M, steps, B, …) where whole time steps are drawn."""
    return leaf if settings.shuffle == "samples" else leaf.reshape(leaf.shape[0], -1, *leaf.shape[3:])


def _in_sequences(settings: PPO, leaf: jax.Array, envs: jax.Array) -> jax.Array:
    """Of (T, B, …) the minibatches (M, L × sequences, …): each environment's T steps cut into sequences."""
    sequences = settings.num_steps // settings.steps_of_a_sequence  # of each environment
    # (T/L, L, M, envs, …) -> (M, L, T/L, envs, …), where the memory has one step of each sequence
    parts = leaf.reshape(sequences, -1, *leaf.shape[1:])[:, :, envs]
    return jnp.moveaxis(parts, (2, 1), (0, 1)).reshape(envs.shape[0], -1, *leaf.shape[2:])


def _own_share(rows: jax.Array, axis_name: str) -> jax.Array:
    """This device's part of the rows of each minibatch; all of them where they cannot be shared evenly."""
    num_devices = jax.lax.axis_size(axis_name)
    if rows.shape[1] % num_devices:
        return rows
    return rows.reshape(rows.shape[0], num_devices, -1)[:, jax.lax.axis_index(axis_name)]
