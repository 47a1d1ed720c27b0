"""Pairs of start and goal, drawn at random in one map."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pecjax.envs.rooms.clearance_grid import ClearanceGrid, clearance_along, make_grid
from pecjax.envs.rooms.config import Configurations, leads_to_waypoint
from pecjax.envs.rooms.geodesics import Paths, find_paths, free_clearance, shortest_ways
from pecjax.envs.rooms.map_file import Map
from pecjax.envs.rooms.plans.generate import MARGIN
from pecjax.errors import InputError

CELL = 0.2  # m, of the grid on which paths are looked for
_BATCH, _TRIES = 1000, 200  # pairs that are drawn at once, and how often before it is given up


class Site(NamedTuple):
    """A map as pairs are drawn in it.

    Attributes:
        bounds: (2, 2) m.
        grid: its clearance.
        paths: its moves.
    """

    bounds: np.ndarray
    grid: ClearanceGrid
    paths: Paths


class Pairs(NamedTuple):
    """Starts and goals, in whole centimetres.

    Attributes:
        start, goal: (N, 2) float32 m.
        shortest: (N,) float32 m, the length of the shortest path.
    """

    start: np.ndarray
    goal: np.ndarray
    shortest: np.ndarray


def make_site(one: Map, radius: float, flight_height: float) -> Site:
    """The map for a drone of this radius (m) at this height (m)."""
    reach = max(free_clearance(radius, CELL) + CELL, radius + MARGIN + CELL)
    grid = make_grid(one.lower, one.upper, one.bounds, flight_height=flight_height, cell=CELL, reach=reach)
    return Site(one.bounds, grid, find_paths(grid, radius))


def free_places(site: Site, draw: np.random.Generator, number: int) -> np.ndarray:
    """So many places (N, 2) m, uniform over where the drone is clear of walls by `MARGIN`."""
    found, (low, high) = np.zeros((0, 2), np.float32), site.bounds
    for _ in range(_TRIES):
        drawn = draw.uniform(low, high, (_BATCH, 2)).round(2).astype(np.float32)
        found = np.concatenate(
            [found, drawn[clearance_along(site.grid, drawn, drawn) > site.paths.radius + MARGIN]]
        )
        if len(found) >= number:
            return found[:number]
    raise InputError(f"no {number} free places were found in {_TRIES * _BATCH:,} draws; make the map larger")


def draw_pairs(
    site: Site,
    draw: np.random.Generator,
    number: int,
    wanted: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Pairs:
    """So many pairs of free places that are joined by a path.

    Args:
        wanted: (distance (M,) m from start to goal, in_sight (M,) bool: whether the straight flight is
            clear) -> (M,) bool, which pairs are kept.

    Raises:
        InputError: they are not found.
    """
    starts, goals = np.zeros((2, 0, 2), np.float32)
    for _ in range(_TRIES):
        start, goal = free_places(site, draw, 2 * _BATCH).reshape(2, _BATCH, 2)
        distance = np.linalg.norm(goal - start, axis=1)
        kept = wanted(distance, in_sight(site, start, goal))
        starts, goals = np.concatenate([starts, start[kept]]), np.concatenate([goals, goal[kept]])
        if len(starts) >= number:
            starts, goals = starts[:number], goals[:number]
            return Pairs(starts, goals, shortest(site, starts, goals))
    raise InputError(f"{len(starts)} of {number} pairs were found in {_TRIES * _BATCH:,} draws; ask for less")


def in_sight(site: Site, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Whether (N,) the drone's sphere can fly straight from start to goal, (N, 2) m each."""
    return clearance_along(site.grid, start, goal) > site.paths.radius


def table_lengths(site: Site, table: Configurations) -> np.ndarray:
    """The lengths (N,) float32 m of the shortest paths, by way of the waypoint where there is one.

    Raises:
        InputError: one has no path.
    """
    start, goal = np.asarray(table.start), np.asarray(table.goal)
    via = leads_to_waypoint(table)
    lengths = np.zeros(table.size, np.float32)
    lengths[~via] = shortest(site, start[~via], goal[~via])
    if via.any():
        waypoint = np.asarray(table.waypoint)[via]
        lengths[via] = shortest(site, start[via], waypoint) + shortest(site, waypoint, goal[via])
    return lengths


def shortest(site: Site, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The length (N,) float32 m of the shortest path from start to goal.

    Raises:
        InputError: no path leads from one to the other.
    """
    lengths = np.array([way.length for way in shortest_ways(site.paths, start, goal)])
    if not np.isfinite(lengths).all():
        row = int(np.argmin(np.isfinite(lengths)))
        raise InputError(f"no path leads from {start[row].tolist()} to {goal[row].tolist()}; move one")
    return lengths.round(3).astype(np.float32)
