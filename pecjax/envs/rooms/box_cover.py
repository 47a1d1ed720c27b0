"""Box cover: boxes along the axes that hold a convex solid and reach little beyond it."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

from pecjax.errors import InputError

_DECIMALS = 12  # of m, beyond which points are the same
_DIGITS = 6  # that MuJoCo saves of a number
_LEAST_SAVED = 0.0001  # of the volume: a cut that saves less may make the next one save more
_NEGLIGIBLE = 1e-3  # of how far a box reaches: what rounding makes of nothing is less
_CORNERS = np.array(list(itertools.product((-1, 1), repeat=3)))


class BoxCover(NamedTuple):
    """Boxes that together hold every point of a solid.

    Attributes:
        middle, half: (N, 3) m, numbers of six digits, which MuJoCo saves as they are.
        reach: m, how far a box reaches beyond the solid at most.
    """

    middle: np.ndarray
    half: np.ndarray
    reach: float


def cover(vertices: np.ndarray, reach: float, most: int) -> BoxCover:
    """Covers a convex solid with boxes.

    A box that reaches too far is cut in two, and both halves are fitted to what they hold.

    Args:
        vertices: (V, 3) m, whose convex hull is the solid.
        reach: m, how far a box may reach beyond it.
        most: boxes.

    Raises:
        InputError: it takes more boxes, or the solid is flat; without the solid's name.
    """
    boxes, waiting = [], [_edges(np.asarray(vertices, np.float64))]
    while waiting:
        edges = waiting.pop()
        points = np.unique(edges.reshape(-1, 3).round(_DECIMALS), axis=0)
        middle, half = _box_around(points)
        # The distance to a convex solid is greatest at a corner of the box.
        beyond = np.array([_away(middle + half * signs, points) for signs in _CORNERS])
        furthest = float(np.linalg.norm(beyond, axis=1).max())
        if furthest <= reach:
            boxes.append((middle, half, furthest))
        else:
            waiting.extend(_halves(edges, np.abs(beyond).max(axis=0) > _NEGLIGIBLE * furthest))
        if len(boxes) + len(waiting) > most:
            raise InputError(f"it takes more than {most} boxes")
    middles, halves, reaches = zip(*boxes, strict=True)
    return BoxCover(np.stack(middles), np.stack(halves), max(reaches))


def _edges(vertices: np.ndarray) -> np.ndarray:
    """Edges (E, 2, 3) of the hull, with some diagonals of its faces."""
    try:
        sides = ConvexHull(vertices).simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    except QhullError as error:
        raise InputError("it is flat") from error
    return vertices[np.unique(np.sort(sides, axis=1), axis=0)]


def _box_around(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half size (3,) m of the box around the points, in numbers of six digits."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle = np.array([float(f"{value:.{_DIGITS}g}") for value in (low + high) / 2])
    least = np.maximum(np.maximum(high - middle, middle - low), 1e-6)
    unit = 10.0 ** (np.floor(np.log10(least)) + 1 - _DIGITS)
    half = np.array([float(f"{value:.{_DIGITS}g}") for value in np.ceil(least / unit) * unit])
    return middle, half


def _away(place: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The way (3,) m to a place from the nearest one in the hull of the points.

    It is found by least squares of their weights.
    """
    scale = np.abs(points - place).max()
    weights, _ = nnls(np.vstack([(points - place).T, np.full(len(points), scale)]), [0, 0, 0, scale])
    return place - weights @ points / weights.sum()


def _halves(edges: np.ndarray, changes: np.ndarray) -> list[np.ndarray]:
    """The solid on both sides of the middle of an axis: a long one, across which a cut saves volume.

    Args:
        changes: (3,) bool, whether the solid changes along an axis; if not, a cut across it is of no use.
    """
    choices = [[_part(edges, axis, side) for side in (-1, 1)] for axis in range(3)]
    extent = np.maximum(np.ptp(edges, axis=(0, 1)), 10.0**-_DECIMALS)
    left = [sum(np.prod(np.ptp(half, axis=(0, 1)) / extent) for half in halves) for halves in choices]
    saved = np.maximum(1 - np.array(left), _LEAST_SAVED)
    return choices[int(np.argmax(changes * saved * extent**2))]


def _part(edges: np.ndarray, axis: int, side: int) -> np.ndarray:
    """The edges of the half that lies below (-1) or above (1) the middle of an axis."""
    along = edges[:, :, axis]
    cut = (along.min() + along.max()) / 2
    inside = side * (along - cut) >= 0
    crosses = inside[:, 0] != inside[:, 1]
    begin, end = np.moveaxis(edges[crosses], 1, 0)
    share = (cut - begin[:, axis]) / (end - begin)[:, axis]
    on_cut = begin + share[:, None] * (end - begin)
    on_cut[:, axis] = cut
    kept_end = np.where(inside[crosses, :1], begin, end)
    kept = np.concatenate([edges[inside.all(axis=1)], np.stack([kept_end, on_cut], axis=1)])
    return np.concatenate([kept, _around(kept[kept[:, :, axis] == cut], axis)])


def _around(points: np.ndarray, axis: int) -> np.ndarray:
    """Edges (N, 2, 3) of the convex face that has these corners, across the axis."""
    points = points[np.unique(points.round(_DECIMALS), axis=0, return_index=True)[1]]
    across = np.delete(points, axis, axis=1)
    x, y = (across - across.mean(axis=0)).T
    ring = points[np.argsort(np.arctan2(y, x))]
    return np.stack([ring, np.roll(ring, 1, axis=0)], axis=1)
