"""Observations: trees of arrays as rows of features, and packed for a replay."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.spaces import Box

LEVELS = 255  # what a byte tells apart


def boxes(space: Any) -> list[Box]:
    """The boxes of an observation space: images first, otherwise in the order of the tree."""
    return [box for box, _ in in_order(space)]


def in_order(space: Any) -> list[tuple[Box, int]]:
    """The boxes as `boxes` has them, and the place of each among the leaves of the tree."""
    leaves = jax.tree.leaves(space)
    return sorted(((box, place) for place, box in enumerate(leaves)), key=lambda pair: not pair[0].is_image)


def image_shapes(space: Any) -> tuple[tuple[int, ...], ...]:
    """Shapes of the images, in the order in which the features begin with them."""
    return tuple(box.shape for box in boxes(space) if box.is_image)


def num_values(space: Any) -> int:
    """How many numbers an observation has."""
    return sum(box.size for box in boxes(space))


def encode(space: Any, obs: Any) -> jax.Array:
    """One row of features (…, F) per observation: its images pixel by pixel, then all else."""
    leaves = jax.tree.leaves(obs)
    parts = [flatten(box, leaves[place]) for box, place in in_order(space)]
    return jnp.concatenate([jnp.asarray(part, jnp.float32) for part in parts], axis=-1)


def pack(space: Any, obs: Any) -> tuple[jax.Array, ...]:
    """An observation as it is kept: (…, n) each; images of finite bounds in 255 steps of a byte."""
    leaves = jax.tree.leaves(obs)
    return tuple(_packed(box, flatten(box, leaves[place])) for box, place in in_order(space))


def unpack(space: Any, packed: tuple[jax.Array, ...]) -> jax.Array:
    """The features of packed observations."""
    parts = [_unpacked(box, part) for box, part in zip(boxes(space), packed, strict=True)]
    return jnp.concatenate(parts, axis=-1)


def flatten(box: Box, leaf: jax.Array) -> jax.Array:
    """One box of an observation as a row of features (…, n)."""
    leading = leaf.shape[: leaf.ndim - len(box.shape)]
    return leaf.reshape(*leading, box.size)


def is_byte(box: Box) -> bool:
    """Whether it is kept in bytes."""
    return box.is_image and bool(np.isfinite([box.low, box.high]).all())


def _packed(box: Box, part: jax.Array) -> jax.Array:
    if not is_byte(box):
        return jnp.asarray(part, jnp.float32)
    share = (part - box.low) / (box.high - box.low)
    return jnp.round(share * LEVELS).astype(jnp.uint8)


def _unpacked(box: Box, part: jax.Array) -> jax.Array:
    return box.low + part.astype(jnp.float32) / LEVELS * (box.high - box.low) if is_byte(box) else part
