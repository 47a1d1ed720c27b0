"""Maps: the walls of one, and a bank of many as device arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

MAX_WALLS = 1000  # of one map; each is a part of every step's program
FEW_WALLS = 16  # up to which each wall is tested in one fused loop; of more, other ways are quicker
FAR_AWAY = 1e9  # m, where boxes without size lie that fill up a map with fewer walls than others


class Walls(NamedTuple):
    """The axis-aligned boxes of one map.

    Attributes:
        lower, upper: (W, 3) m, opposite corners.
    """

    lower: Any
    upper: Any


class MapBank(NamedTuple):
    """M maps; an argument of every program, so that another bank of the same shape compiles nothing.

    Attributes:
        lower, upper: (M, W, 3) m, corners of the walls; boxes of no size far away fill up maps with
            fewer of them than the others.
        bounds: (M, 2, 2) m, lower and upper corner in x and y of each map.
    """

    lower: Any
    upper: Any
    bounds: Any


def make_bank(maps: Sequence[Any]) -> MapBank:
    """A bank of maps, each with `lower` and `upper` (W, 3) and `bounds` (2, 2), as `scene.Map` has them."""
    most = max(len(one.lower) for one in maps)

    def filled(corners: np.ndarray) -> np.ndarray:
        return np.pad(corners, [(0, most - len(corners)), (0, 0)], constant_values=FAR_AWAY)

    lower, upper = (
        np.stack([filled(getattr(one, name)) for one in maps]).astype(np.float32) for name in Walls._fields
    )
    return MapBank(lower, upper, np.stack([one.bounds for one in maps]).astype(np.float32))


def pick(bank: MapBank, map_id: jax.Array) -> Walls:
    """The walls of one map of the bank."""
    if bank.lower.shape[0] == 1:  # not a copy for every environment of a batch
        return Walls(jnp.asarray(bank.lower)[0], jnp.asarray(bank.upper)[0])
    return Walls(jnp.asarray(bank.lower)[map_id], jnp.asarray(bank.upper)[map_id])
