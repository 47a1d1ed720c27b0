"""Furniture: boxes of several heights within the rooms of a layout; all lengths in whole centimetres."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pecjax.envs.rooms.plans.families import Family
from pecjax.envs.rooms.plans.layout import HALF_WALL, HEIGHT, Layout

_TRIES = 12  # for a place of one piece, then it is left out
_CLEAR = 60  # cm before and behind a door that stay empty


class _Kind(NamedTuple):
    """Ranges of sizes in cm.

    Attributes:
        long, deep: from above.
        bottom, top: of each.
        along_walls: share of them that stand with their long side at a wall.
    """

    long: tuple[int, int]
    deep: tuple[int, int]
    bottom: tuple[int, int]
    top: tuple[int, int]
    along_walls: float


# By the names of the family's counts. A drone of 0.25 m at 1.2 m touches what is higher than 0.95 m and
# what hangs lower than 1.45 m.
_KINDS = {
    "pillars": _Kind((25, 90), (25, 90), (0, 0), (HEIGHT, HEIGHT), 0.0),
    "shelves": _Kind((80, 220), (30, 60), (0, 0), (80, 230), 0.8),
    "low": _Kind((60, 180), (40, 90), (0, 0), (40, 85), 0.5),
    "hanging": _Kind((30, 240), (20, 40), (100, 215), (HEIGHT, HEIGHT), 0.0),
}


def draw_furniture(draw: np.random.Generator, family: Family, layout: Layout, most: int) -> np.ndarray:
    """Draws at most `most` pieces, clear of doors and of one another.

    Returns:
        (n, 6) lower x, y, z and upper x, y, z.
    """
    doors_low, doors_high = _before_doors(layout)
    kept, number = np.zeros((most, 6), np.int64), 0
    for name, kind in _KINDS.items():
        first, last = getattr(family, name)
        pieces, fits = _candidates(draw, kind, layout, int(draw.integers(first, last + 1)))
        before_door = (pieces[:, :, None, :2] < doors_high) & (pieces[:, :, None, 3:5] > doors_low)
        fits &= ~before_door.all(axis=-1).any(axis=-1)
        for places, possible in zip(pieces[: most - number], fits, strict=False):
            there = (places[:, None, :3] < kept[:number, 3:]) & (places[:, None, 3:] > kept[:number, :3])
            possible = possible & ~there.all(axis=-1).any(axis=-1)
            if possible.any():
                kept[number] = places[possible.argmax()]
                number += 1
    return kept[:number]


def _before_doors(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """The corners (d, 2) of what stays empty around the doors, which are as deep as walls are thick."""
    low, high = layout.doors[:, :2], layout.doors[:, 2:]
    room = np.where(high - low <= 2 * HALF_WALL, _CLEAR, 0)
    return low - room, high + room


def _candidates(
    draw: np.random.Generator, kind: _Kind, layout: Layout, number: int
) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, t, 6) for so many pieces, in a room each, and whether they fit into that (n, t)."""
    low, high = np.array([kind.long, kind.deep, kind.bottom, kind.top]).T
    shape = draw.integers(low, high + 1, (number, 1, 4))
    chance = draw.random((number, _TRIES, 7))
    turned, right = chance[..., :1] < 0.5, chance[..., 1:2] < 0.5
    size = np.where(turned, shape[..., 1::-1], shape[..., :2])
    room = [np.floor(chance[..., 2 + k] * (len(layout.lines[k]) - 1)).astype(int) for k in range(2)]
    corner, end = (
        np.stack([layout.lines[k][room[k] + further] for k in range(2)], axis=-1) for further in range(2)
    )
    least, most = corner + HALF_WALL, end - HALF_WALL - size
    place = np.floor(least + chance[..., 4:6] * (most - least + 1)).astype(np.int64)
    # The short side points away from the wall: along x when the piece is turned.
    away = np.concatenate([turned, ~turned], axis=-1) & (chance[..., 6:] < kind.along_walls)
    place = np.where(away, np.where(right, least, most), place)
    bottom, top = (np.broadcast_to(shape[..., k, None], (number, _TRIES, 1)) for k in (2, 3))
    boxes = np.concatenate([place, bottom, place + size, top], axis=-1)
    return boxes, np.all(most >= least, axis=-1)
