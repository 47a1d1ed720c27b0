"""Path fields: how far it is to a goal, and which way, from everywhere in a map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.rooms.clearance_grid import make_grid
from pecjax.envs.rooms.config import Configurations, leads_to_waypoint
from pecjax.envs.rooms.geodesics import find_paths, free_clearance, search
from pecjax.envs.rooms.maps import FAR_AWAY, MapBank
from pecjax.envs.rooms.sensing import DISTANCE_SCALE
from pecjax.errors import InputError

CELL = 0.2  # m
AHEAD = 5  # cells of a path: where it leads to, seen from where the drone is
MOST_BYTES = 2**30  # of all fields together
_UNIT = 0.25  # m, of the lengths
_AT_ONCE = 256  # goals whose distances are held in full
_TURN = 256  # of the bearings


class PathFields(NamedTuple):
    """Shortest paths to up to K places in each of M maps, on grids of `CELL`.

    The goals of one cell share the paths to the first of them.

    Attributes:
        field: (M, X, Y) int16, which of the K places is nearest to a cell, so that a goal that lies between
            two cells may be rounded either way.
        bearing: (M, K, X, Y) int8, the direction in which a path goes on, in 1/256 of a turn.
        length: (M, K, X, Y) uint8, of the path, in steps of 0.25 m, 255 where there are more or no path.
        origin: (M, 2) m, of the grids.
    """

    field: Any
    bearing: Any
    length: Any
    origin: Any


def path_from(
    fields: PathFields, map_id: jax.Array, goal: jax.Array, place: jax.Array, heading: jax.Array
) -> jax.Array:
    """The path's length, and the sine and cosine of its direction off the heading, (3,), scaled.

    Args:
        goal, place: (2,) m; the goal is one of the map's.
        heading: () rad.
    """
    cells = jnp.round((jnp.stack([goal, place]) - fields.origin[map_id]) / CELL).astype(jnp.int32)
    there, here = jnp.clip(cells, 0, np.array(fields.field.shape[1:]) - 1)
    at = (map_id, fields.field[map_id, *there], *here)
    turn = fields.bearing[at] * (2 * jnp.pi / _TURN) - heading
    return jnp.stack([fields.length[at] * (_UNIT / DISTANCE_SCALE), jnp.sin(turn), jnp.cos(turn)])


def make_path_fields(
    bank: MapBank, tables: Sequence[Configurations], *, radius: float, flight_height: float
) -> PathFields:
    """The fields of all goals and waypoints of the tables; those of 10,000 maps take about half a minute.

    Args:
        radius, flight_height: m, of the drone.

    Raises:
        InputError: see `find_goals`.
    """
    lower, upper, bounds = map(np.asarray, (bank.lower, bank.upper, bank.bounds))
    origin, shape = _grids(bounds)
    goals = find_goals(bounds, tables)
    most = max(map(len, goals))
    field = np.zeros((len(goals), *shape), np.int16)
    bearing = np.zeros((len(goals), most, *shape), np.int8)
    length = np.full(bearing.shape, 255, np.uint8)
    for number, some in enumerate(goals):
        if not len(some):
            continue
        field[number] = _nearest(_cells(some, origin[number]), shape)
        walls = lower[number, :, 0] < FAR_AWAY
        here = lower[number, walls], upper[number, walls], bounds[number]
        found = _field(some, *here, flight_height, radius)
        x, y = found[0].shape[1:]
        bearing[number, : len(some), :x, :y], length[number, : len(some), :x, :y] = found
    return PathFields(field, bearing, length, origin)


def find_goals(bounds: np.ndarray, tables: Sequence[Configurations]) -> list[np.ndarray]:
    """Of each map the goals and waypoints (K, 2) m, the first in each cell.

    Args:
        bounds: (M, 2, 2) m, of the maps.

    Raises:
        InputError: the paths to all of them would take more than `MOST_BYTES`.
    """
    origin, shape = _grids(bounds)
    map_id, goal = [], []
    for table in tables:
        number = np.asarray(table.map_id)
        map_id.append(number)
        goal.append(np.asarray(table.goal))
        if table.waypoint is not None:
            by_way = leads_to_waypoint(table)
            map_id.append(number[by_way])
            goal.append(np.asarray(table.waypoint)[by_way])
    number, places = np.concatenate(map_id), np.concatenate(goal)
    order = np.argsort(number, kind="stable")
    by_map = np.split(places[order], np.searchsorted(number[order], np.arange(1, len(origin))))
    goals = [
        some[np.unique(_cells(some, at), axis=0, return_index=True)[1]]
        for some, at in zip(by_map, origin, strict=True)
    ]
    most = max(map(len, goals))
    if (taken := 2 * len(goals) * (most + 1) * math.prod(shape)) > MOST_BYTES:
        raise InputError(
            f"the paths to {most:,} goals in each of {len(goals):,} maps take {taken / 2**30:.0f} GiB, "
            f"{MOST_BYTES / 2**30:.0f} is the most; leave out critic-paths"
        )
    return goals


def _grids(bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The origins (M, 2) m of the grids, and the shape (2,) that the largest has."""
    shape = np.round((bounds[:, 1] - bounds[:, 0]).max(axis=0) / CELL).astype(int) + 1
    return bounds[:, 0].astype(np.float32), shape


def _cells(places: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """The cells (N, 2) of places (N, 2) m."""
    return np.round((places - origin) / CELL).astype(int)


def _nearest(cells: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Which of some cells (N, 2) is nearest to each cell of a grid."""
    from scipy.ndimage import distance_transform_edt

    number = np.full(shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    at = np.asarray(distance_transform_edt(number < 0, return_distances=False, return_indices=True))
    return number[tuple(at)]


def _field(
    goals: np.ndarray, lower: np.ndarray, upper: np.ndarray, bounds: np.ndarray, height: float, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Bearings and lengths (K, X, Y) of one map, as `PathFields` has them.

    Places too near to a wall have those of the nearest free cell. Where no path leads to the goal its
    direction is straight; where there is no free cell at all it is 0.

    Args:
        goals: (K, 2) m.
    """
    from scipy.ndimage import distance_transform_edt

    reach = free_clearance(radius, CELL) + CELL
    grid = make_grid(lower, upper, bounds, flight_height=height, cell=CELL, reach=reach)
    paths = find_paths(grid, radius)
    shape = (len(goals), *paths.number.shape)
    if not len(paths.places):
        return np.zeros(shape, np.int8), np.full(shape, 255, np.uint8)
    taken = paths.number < 0
    nearest = np.asarray(distance_transform_edt(taken, return_distances=False, return_indices=True))
    node = paths.number[tuple(nearest)]
    bearing, length = np.empty(shape, np.int8), np.empty(shape, np.uint8)
    for first in range(0, len(goals), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        distances, onwards = search(paths, goals[some])
        turns = np.stack([_turns(paths.places, *one) for one in zip(goals[some], onwards, strict=True)])
        bearing[some] = turns[:, node]
        length[some] = np.minimum(distances / _UNIT, 255).astype(np.uint8)[:, node]
    return bearing, length


def _turns(places: np.ndarray, goal: np.ndarray, onwards: np.ndarray) -> np.ndarray:
    """Where to from each node (K,), in the unit of bearings; paths go on to these nodes, -1 for the goal."""
    step = np.where(onwards < 0, np.arange(len(onwards)), onwards)
    place = np.arange(len(onwards))
    for _ in range(AHEAD):
        place = step[place]
    offset = np.where((onwards[place] < 0)[:, None], goal, places[place]) - places
    turn = np.round(np.arctan2(offset[:, 1], offset[:, 0]) * (_TURN / (2 * np.pi))).astype(int)
    return ((turn + _TURN // 2) % _TURN - _TURN // 2).astype(np.int8)
