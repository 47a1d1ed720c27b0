"""Clearance on a grid: how far each cell at the flight height is from the nearest wall."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pecjax.errors import InputError

MAX_CELLS = 2**23


class ClearanceGrid(NamedTuple):
    """A map at the flight height; cell (i, j) is the place `origin` + `cell` (i, j).

    Attributes:
        clearance: (X, Y) m to the nearest wall, 0 inside one; `reach` where it is more.
        origin: (2,) m.
        cell: m.
        lower, upper: (B, 2) m, the walls within `reach` of the flight height, from above.
        gap: (B,) m, how far above or below the flight height each of them is.
    """

    clearance: np.ndarray
    origin: np.ndarray
    cell: float
    lower: np.ndarray
    upper: np.ndarray
    gap: np.ndarray


def make_grid(
    lower: np.ndarray,
    upper: np.ndarray,
    bounds: np.ndarray,
    *,
    flight_height: float,
    cell: float,
    reach: float,
) -> ClearanceGrid:
    """Paints the walls of one map, each with what lies within `reach` of it.

    Args:
        lower, upper: (W, 3) m, the walls' corners.
        bounds: (2, 2) m, the corners in x and y between which cells are.
        reach: m, the clearance beyond which it does not matter.

    Raises:
        InputError: the map has too many cells.
    """
    lower, upper, bounds = (np.asarray(part, np.float64) for part in (lower, upper, bounds))
    extent = bounds[1] - bounds[0]
    if not np.prod(extent / cell + 1) <= MAX_CELLS:
        raise InputError(
            f"the map is {extent[0]:g} by {extent[1]:g} m; {MAX_CELLS * cell**2:,.0f} m² is the most that "
            "paths are looked for on, make it smaller"
        )
    gap = np.maximum(np.maximum(lower[:, 2] - flight_height, flight_height - upper[:, 2]), 0)
    near = (gap < reach) & np.all((lower[:, :2] < bounds[1] + reach) & (upper[:, :2] > bounds[0] - reach), 1)
    low, high, gap = lower[near, :2], upper[near, :2], gap[near]
    shape = np.floor(extent / cell + 1e-6).astype(int) + 1
    squared = np.full(shape, reach**2)
    beyond = []
    for axis in range(2):
        along = bounds[0, axis] + cell * np.arange(shape[axis])
        beyond.append(np.maximum(np.maximum(low[:, axis, None] - along, along - high[:, axis, None]), 0) ** 2)
    beyond[0] += gap[:, None] ** 2
    first = np.clip(np.floor((low - reach - bounds[0]) / cell).astype(int), 0, shape)
    last = np.clip(np.ceil((high + reach - bounds[0]) / cell).astype(int) + 1, 0, shape)
    for wall, ((left, bottom), (right, top)) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        part = squared[left:right, bottom:top]
        here = beyond[0][wall, left:right, None] + beyond[1][wall, None, bottom:top]
        np.minimum(part, here, out=part)
    return ClearanceGrid(np.sqrt(squared), bounds[0], cell, low, high, gap)


def clearance_along(grid: ClearanceGrid, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest clearance (N,) m on straight flights from `start` to `end`, (N, 2) m each.

    It is exact up to the grid's reach, and infinite where there is no wall within it.
    """
    start, end = (np.asarray(points, np.float64)[:, None] for points in (start, end))
    way = end - start
    slope = np.where(way == 0, 1e-300, way)  # what is parallel to a side enters and leaves far away
    times = np.stack([(grid.lower - start) / slope, (grid.upper - start) / slope])
    enters, leaves = times.min(axis=0).max(axis=-1), times.max(axis=0).min(axis=-1)
    crosses = (enters <= leaves) & (enters <= 1) & (leaves >= 0)
    squared = np.minimum(_beyond(grid, start), _beyond(grid, end))
    length = np.maximum(np.sum(way**2, axis=-1), 1e-300)
    for x in (grid.lower[:, 0], grid.upper[:, 0]):
        for y in (grid.lower[:, 1], grid.upper[:, 1]):
            corner = np.stack([x, y], axis=-1)
            nearest = np.clip(np.sum((corner - start) * way, axis=-1) / length, 0, 1)
            off = start + nearest[..., None] * way - corner
            squared = np.minimum(squared, np.sum(off**2, axis=-1))
    squared = np.where(crosses, 0, squared) + grid.gap**2
    return np.sqrt(np.min(squared, axis=1, initial=np.inf))


def _beyond(grid: ClearanceGrid, points: np.ndarray) -> np.ndarray:
    """Squared distance from above of points (N, 1, 2) from each wall."""
    off = np.maximum(np.maximum(grid.lower - points, points - grid.upper), 0)
    return np.sum(off**2, axis=-1)
