"""Measures of one plan: the shortest path, its doorways, the narrowest passage."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from pecjax.envs.rooms.clearance_grid import ClearanceGrid, make_grid
from pecjax.envs.rooms.geodesics import Paths, Way, find_paths
from pecjax.envs.rooms.plans.families import WALL
from pecjax.envs.rooms.plans.plans import CELL, FLIGHT_HEIGHT, RADIUS

WIDEST_DOORWAY = 2.0  # m; what is wider is no door


class Measures(NamedTuple):
    """Of one plan; see `plans.Plans`."""

    geodesic: float
    narrowest: float
    doors: int


def plan_paths(
    lower: np.ndarray, upper: np.ndarray, bounds: np.ndarray, *, radius: float = RADIUS, cell: float = CELL
) -> Paths:
    """The graph on which a plan is measured; its clearance reaches as far as the floor is away."""
    grid = make_grid(lower, upper, bounds, flight_height=FLIGHT_HEIGHT, cell=cell, reach=FLIGHT_HEIGHT)
    return find_paths(grid, radius)


def measure(paths: Paths, lower: np.ndarray, upper: np.ndarray, way: Way) -> Measures:
    """Measures one plan (its boxes' corners (w, 3) m) along its shortest path, which there must be."""
    return Measures(
        way.length,
        narrowest(paths.grid, way.points[0], way.points[-1], paths.radius),
        doors_on_the_way(doorways(lower, upper), way.points),
    )


def narrowest(grid: ClearanceGrid, start: np.ndarray, goal: np.ndarray, radius: float) -> float:
    """The diameter (m) of the widest sphere that can roll from start to goal, from 2 `radius` on.

    It begins wherever it covers the start and ends wherever it covers the goal, so that a wall beside
    these is no passage. It is found to the centimetre, among spheres around the grid's cells.
    """
    clearance = np.floor(100 * grid.clearance + 1e-3).astype(np.int16)
    around = [_around(grid, point) for point in (start, goal)]
    fits, too_wide = int(100 * radius), int(clearance.max()) + 1
    while too_wide - fits > 1:
        middle = (fits + too_wide) // 2
        regions: np.ndarray = ndimage.label(clearance >= middle)[0]  # pyright: ignore
        ends = [set(regions[part][away <= middle + 1e-4].tolist()) for part, away in around]
        joined = ends[0] & ends[1] - {0}
        fits, too_wide = (middle, too_wide) if joined else (fits, middle)
    return 2 * fits / 100


def _around(grid: ClearanceGrid, point: np.ndarray) -> tuple[tuple[slice, slice], np.ndarray]:
    """The part of the grid around a place, and how far (cm) its cells are from there."""
    most = float(grid.clearance.max())
    first = np.maximum(np.floor((point - grid.origin - most) / grid.cell).astype(int), 0)
    last = np.ceil((point - grid.origin + most) / grid.cell).astype(int) + 1
    part = slice(int(first[0]), int(last[0])), slice(int(first[1]), int(last[1]))
    x, y = (
        grid.origin[axis] + grid.cell * np.arange(size)[part[axis]] - point[axis]
        for axis, size in enumerate(grid.clearance.shape)
    )
    return part, 100 * np.hypot(x[:, None], y)


def doorways(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The gaps of at most `WIDEST_DOORWAY` between two walls on one line.

    A wall is 0.2 m thick, longer than that, and stands in the drone's way.

    Args:
        lower, upper: (w, 3) m, corners of a plan's boxes.

    Returns:
        (d, 2, 2) m, the two ends in x and y of each, in the middle of the wall.
    """
    low, high = (np.round(100 * np.asarray(part, np.float64)).astype(int) for part in (lower, upper))
    thick = round(100 * WALL)
    touch = round(100 * RADIUS)
    height = round(100 * FLIGHT_HEIGHT)
    stands = (low[:, 2] <= height - touch) & (high[:, 2] >= height + touch)
    found = []
    for axis in range(2):  # along which the wall runs
        other = 1 - axis
        is_wall = stands & (high[:, other] - low[:, other] == thick) & (high[:, axis] - low[:, axis] > thick)
        begin, end, line = low[is_wall, axis], high[is_wall, axis], low[is_wall, other]
        order = np.lexsort((begin, line))
        begin, end, line = begin[order], end[order], line[order]
        gap = begin[1:] - end[:-1]
        door = (line[1:] == line[:-1]) & (gap > 0) & (gap <= 100 * WIDEST_DOORWAY)
        ends = np.zeros((int(door.sum()), 2, 2))
        ends[:, :, other] = line[1:][door, None] + thick / 2
        ends[:, 0, axis], ends[:, 1, axis] = end[:-1][door], begin[1:][door]
        found.append(ends / 100)
    return np.concatenate(found)


def doors_on_the_way(doors: np.ndarray, points: np.ndarray) -> int:
    """How many doorways (d, 2, 2) m a path of points (P, 2) m goes through."""
    through = 0
    for axis in range(2):
        one = doors[doors[:, 0, 1 - axis] == doors[:, 1, 1 - axis]]
        side = points[:, 1 - axis] - one[:, 0, 1 - axis, None]
        step = side[:, 1:] - side[:, :-1]
        # Where the line is crossed, as a share of each step; one that runs along it crosses nothing.
        share = -side[:, :-1] / np.where(step == 0, np.inf, step)
        at = points[:-1, axis] + share * np.diff(points[:, axis])
        crosses = (side[:, :-1] < 0) != (side[:, 1:] < 0)
        between = (at > one[:, 0, axis, None]) & (at < one[:, 1, axis, None])
        through += int((crosses & between).any(axis=1).sum())
    return through
