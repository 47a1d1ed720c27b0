"""The agent's contract, and how one is spread over devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pecjax.agents.rollout import Episodes
from pecjax.curriculum.base import count_outcomes

AXIS = "devices"


class TrainState(NamedTuple):
    """Everything a training is made of; saving it is saving the run.

    Attributes:
        learner: parameters and optimiser, the agent's own.
        sampler: the sampler's state.
        fleet: the environments and what the agent keeps of each; the only part that is spread
            over devices, by its leading axis.
        key: of all randomness to come.
    """

    learner: Any
    sampler: Any
    fleet: Any
    key: Any


class Metrics(NamedTuple):
    """What one iteration did; "training" figures are over the sampler's own distribution.

    Attributes:
        counts: (2, N) int32, trials and failures of this iteration by configuration.
        reported: (2,) int32, trials and failures that its goal ratio is of: all, or those of the
            actors that explore least.
        return_sum, length_sum: over the episodes that ended.
        unstable: () int32, episodes that ended since their physics blew up; collisions all.
        finite: by name, whether each of the losses, the parameters and the physics are finite.
        losses: the learner's own figures by name.
    """

    counts: jax.Array
    reported: jax.Array
    return_sum: jax.Array
    length_sum: jax.Array
    unstable: jax.Array
    finite: dict[str, jax.Array]
    losses: dict[str, jax.Array]

    @property
    def non_finite(self) -> list[str]:
        """The names of what is not finite, once the figures are the host's."""
        return [name for name, finite in self.finite.items() if not finite]


class Agent(NamedTuple):
    """A learner, a sampler and their environments as pure functions.

    Attributes:
        init: (key, numbers=None) -> TrainState; the numbers are for `Sampler.init`.
        iterate: (TrainState) -> (TrainState, Metrics), one iteration of the paper's Fig. 1
            (lines 2-16).
        policy: (TrainState.learner, greedy=False) -> act, where act(obs, key) -> action for a
            single observation.
        steps_per_iteration: environment steps of one iteration, over all environments.
        replay_bytes: that the replay takes, over all devices.
    """

    init: Callable[..., TrainState]
    iterate: Callable[[TrainState], tuple[TrainState, Metrics]]
    policy: Callable[..., Callable[[Any, jax.Array], jax.Array]]
    steps_per_iteration: int
    replay_bytes: int = 0


def are_finite(parts: dict[str, Any], axis_name: str | None) -> dict[str, jax.Array]:
    """For every part, whether all its numbers, on all devices, are finite."""

    def of_part(part: Any) -> jax.Array:
        leaves = [leaf for leaf in jax.tree.leaves(part) if jnp.issubdtype(leaf.dtype, jnp.floating)]
        return jnp.all(jnp.array([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))

    finite = {name: of_part(part) for name, part in parts.items()}
    if axis_name is None:
        return finite
    return jax.tree.map(lambda yes: yes > 0, jax.lax.pmin(jax.tree.map(jnp.int32, finite), axis_name))


def summarize(
    episodes: Episodes,
    finite: dict[str, jax.Array],
    losses: dict[str, jax.Array],
    num_configs: int,
    axis_name: str | None,
    reported: jax.Array | bool = True,
) -> Metrics:
    """Sums an iteration's endings over its steps, environments and devices.

    Args:
        reported: (B,) bool, the environments that the goal ratio is taken over.
    """
    done, failed = episodes.outcomes.done, episodes.outcomes.failed
    seen = jnp.stack([jnp.sum(done & reported), jnp.sum(done & failed & reported)])
    return_sum, length_sum = jnp.sum(done * episodes.returns), jnp.sum(done * episodes.lengths)
    unstable = jnp.sum(done & episodes.unstable)
    if axis_name is not None:
        sums = (seen, return_sum, length_sum, unstable)
        seen, return_sum, length_sum, unstable = jax.lax.psum(sums, axis_name)
    counts = count_outcomes(episodes.outcomes, num_configs, axis_name)
    return Metrics(counts, seen, return_sum, length_sum, unstable, finite, losses)


def device_mean(tree: Any, axis_name: str | None) -> Any:
    """The mean over devices, in one sum for all arrays: each sum costs a rendezvous."""
    if axis_name is None:
        return tree
    flat, unflatten = ravel_pytree(tree)
    return unflatten(jax.lax.pmean(flat, axis_name))


def fleet_mesh(num_devices: int) -> Mesh:
    """A mesh of the first `num_devices` devices along one axis, `AXIS`."""
    return Mesh(np.array(jax.devices()[:num_devices]), (AXIS,))


def placement(mesh: Mesh) -> TrainState:
    """Where each part of a TrainState lives: the fleet is spread over the mesh, the rest is everywhere."""
    everywhere, spread = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))
    return TrainState(learner=everywhere, sampler=everywhere, fleet=spread, key=everywhere)


def shard(agent: Agent, mesh: Mesh) -> Agent:
    """Spreads an agent's environments over the mesh.

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
        in_specs=(specs,),
        out_specs=(specs, PartitionSpec()),
        check_vma=False,
    )
    return agent._replace(init=jax.jit(agent.init, out_shardings=places), iterate=iterate)
