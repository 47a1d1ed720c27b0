"""Metrics: one iteration summarized in a fixed set of numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.agents.episodes import Episodes


class Metrics(NamedTuple):
    """Figures of one iteration, over the sampler's own distribution.

    Attributes:
        episodes: () int32, how many ended.
        reported: (2,) int32, the trials and failures of its goal ratio: all, or those of the actors that
            explore least.
        sums: by name, sums over the episodes that ended: `return`, `length` and the task's metrics.
        finite: by name, whether each of the losses, the parameters and the observations are finite.
        losses: the learner's own figures by name.
        sampler: how the next draws are spread, by name (see `curriculum.diagnose`).
    """

    episodes: jax.Array
    reported: jax.Array
    sums: dict[str, jax.Array]
    finite: dict[str, jax.Array]
    losses: dict[str, jax.Array]
    sampler: dict[str, jax.Array]

    @property
    def non_finite(self) -> list[str]:
        """The names of what is not finite, once the figures are the host's."""
        return [name for name, finite in self.finite.items() if not finite]


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
    sampler: dict[str, jax.Array],
    axis_name: str | None,
    reported: jax.Array | bool = True,
) -> Metrics:
    """Sums an iteration's endings over its steps, environments and devices.

    Args:
        finite, losses, sampler: as `Metrics` has them.
        reported: (B,) bool, the environments that the goal ratio is taken over.
    """
    outcomes = episodes.outcomes
    done, failed = outcomes.done, outcomes.failed
    figures: dict[str, jax.Array] = {"return": outcomes.episode_return, "length": outcomes.length}
    figures |= episodes.metrics
    sums = {name: jnp.sum(jnp.where(done, value, 0)) for name, value in figures.items()}
    trials = jnp.stack([jnp.sum(done & reported), jnp.sum(done & failed & reported)])
    number = jnp.sum(done)
    if axis_name is not None:
        number, trials, sums = jax.lax.psum((number, trials, sums), axis_name)
    return Metrics(number, trials, sums, finite, losses, sampler)
