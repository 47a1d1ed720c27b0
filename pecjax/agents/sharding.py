"""Sharding: how an agent's environments are spread over devices."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pecjax.agents.base import Agent, TrainState

AXIS = "devices"


def env_keys(key: jax.Array, env_ids: jax.Array) -> jax.Array:
    """One key per environment, by its global number, so that sharding does not change draws."""
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, env_ids)


def global_ids(num_local: int, axis_name: str | None) -> jax.Array:
    """The global numbers of what this device holds of something spread over the mesh axis."""
    first = 0 if axis_name is None else jax.lax.axis_index(axis_name) * num_local
    return first + jax.numpy.arange(num_local)


def device_mean(tree: Any, axis_name: str | None) -> Any:
    """The mean over devices, in one sum for all arrays: each sum costs a rendezvous."""
    if axis_name is None:
        return tree
    flat, unflatten = ravel_pytree(tree)
    return unflatten(jax.lax.pmean(flat, axis_name))


def device_mesh(num_devices: int) -> Mesh:
    """A mesh of the first `num_devices` devices along one axis, `AXIS`."""
    return Mesh(np.array(jax.devices()[:num_devices]), (AXIS,))


def placement(mesh: Mesh) -> TrainState:
    """Where a TrainState lives: environments are spread over the mesh, the rest is everywhere."""
    everywhere, spread = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))
    return TrainState(everywhere, everywhere, everywhere, envs=spread, key=everywhere)


def shard(agent: Agent, mesh: Mesh) -> Agent:
    """Spreads an agent's environments over the mesh; the world is everywhere.

    The agent must have been made with `axis_name=AXIS`. What it draws and flies does not depend on
    the number of devices, but for the rounding of sums.
    """
    places = placement(mesh)
    specs = TrainState(*(place.spec for place in places))
    # Without varying-axes checks the gradient of replicated parameters stays each device's own,
    # and the learner takes the mean over devices itself.
    iterate = jax.shard_map(
        agent.iterate,
        mesh=mesh,
        in_specs=(specs, PartitionSpec()),
        out_specs=(specs, PartitionSpec()),
        check_vma=False,
    )
    return agent._replace(init=jax.jit(agent.init, out_shardings=places), iterate=iterate)
