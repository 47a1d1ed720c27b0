"""Validity: whether the drone can fly every configuration of a table in a map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from pecjax.envs.axes import fill
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.clearance_grid import make_grid
from pecjax.envs.rooms.config import Configurations, leads_to_waypoint, row_name
from pecjax.envs.rooms.map_file import Map
from pecjax.envs.rooms.maps import Walls
from pecjax.envs.rooms.scene import Scene
from pecjax.errors import InputError

CELL = 0.05  # m, of the grid on which reachability is decided

_wall_distance = jax.jit(wall_distance)


def check_coordinates(
    scene: Scene, table: Configurations, *, flight_height: float, source: str | Path | None = None
) -> None:
    """Makes sure that every configuration can be flown in one scene (see `check_configurations`)."""
    check_configurations([scene.map], fill(table), scene.drone_radius, flight_height, source)


def check_configurations(
    maps: Sequence[Map],
    table: Configurations,
    radius: float,
    flight_height: float,
    source: str | Path | None = None,
) -> None:
    """Makes sure that every configuration can be flown in its map.

    Start and goal must lie inside the map and clear of its walls by the drone's radius, differ,
    and be joined by a path that the drone's sphere fits through at its flight height. A waypoint that an
    objective leads to must lie so too, and on such a path.

    Args:
        radius, flight_height: m, of the drone.
        source: what `load_coordinates` read the table from, for messages.

    Raises:
        InputError: a row that names a map that is not there or cannot be flown, with the point at fault.
    """
    if table.waypoint is not None and table.objective is None:
        raise InputError(f"{source or 'the table'}: waypoints without objectives; add a column objective")

    def name(row: int) -> str:
        return row_name(source, int(row), type(table))

    for row in _first(leads_to_waypoint(table)) if table.waypoint is None else []:
        raise InputError(
            f"{name(row)}: its objective leads to a waypoint; add columns waypoint_x, waypoint_y"
        )
    map_id = np.asarray(table.map_id)
    for row in _first((map_id < 0) | (map_id >= len(maps))):
        raise InputError(f"{name(row)}: there is no map {map_id[row]}; the maps are 0 to {len(maps) - 1}")
    for number in np.unique(map_id):
        _check_in_map(maps[number], table, np.flatnonzero(map_id == number), radius, flight_height, name)


def _check_in_map(
    one: Map,
    table: Configurations,
    chosen: np.ndarray,
    radius: float,
    flight_height: float,
    name: Callable[[int], str],
) -> None:
    """`check_configurations` of the rows that fly in one map."""
    start, goal = np.asarray(table.start)[chosen], np.asarray(table.goal)[chosen]
    passed = leads_to_waypoint(table)[chosen]
    # Where there is no waypoint to pass, the goal stands for it.
    waypoint = goal if table.waypoint is None else np.where(passed[:, None], table.waypoint[chosen], goal)
    low, high = one.bounds

    for role, points in (("start", start), ("goal", goal), ("waypoint", waypoint)):
        for row in _first(np.any((points < low) | (points > high), axis=1)):
            raise InputError(f"{name(chosen[row])}: {role} {_at(points[row])} lies outside the map; move it")
        heights = np.full((len(points), 1), flight_height, points.dtype)
        gaps = np.asarray(_distances(one, np.hstack([points, heights])))
        for row in _first(gaps <= radius):
            where = "inside a wall" if gaps[row] == 0 else f"{gaps[row]:.2f} m from a wall"
            raise InputError(
                f"{name(chosen[row])}: {role} {_at(points[row])} lies {where}; keep it "
                f"more than {radius:g} m, the drone's radius, away"
            )
    for row in _first(np.all(start == goal, axis=1) & ~passed):
        raise InputError(f"{name(chosen[row])}: start and goal are both {_at(start[row])}; move one")
    regions, origin = free_regions(one, radius, flight_height)
    from_start = regions_at(regions, origin, start)
    for points in (waypoint, goal):
        there = regions_at(regions, origin, points)
        meet = (from_start[:, :, None] == there[:, None, :]) & (from_start[:, :, None] > 0)
        for row in _first(~meet.any(axis=(1, 2))):
            raise InputError(
                f"{name(chosen[row])}: no path of {2 * radius:g} m width leads from "
                f"{_at(start[row])} to {_at(points[row])}; widen a door or move a point"
            )


def _distances(one: Map, points: np.ndarray) -> jax.Array:
    return _wall_distance(Walls(one.lower, one.upper), jnp.asarray(points, jnp.float32))


def _first(wrong: np.ndarray) -> list[int]:
    return [int(wrong.argmax())] if wrong.any() else []


def _at(point: np.ndarray) -> str:
    return f"({point[0]:g}, {point[1]:g})"


def free_regions(one: Map, radius: float, flight_height: float) -> tuple[np.ndarray, np.ndarray]:
    """Labels the places that the drone's centre may take, one number per connected region.

    Returns:
        (X, Y) int labels, 0 where the drone does not fit, and (2,) m, the place of cell (0, 0);
        cells are `CELL` metres apart.

    Raises:
        InputError: the map is too large for that.
    """
    grid = make_grid(
        one.lower, one.upper, one.bounds, flight_height=flight_height, cell=CELL, reach=radius + CELL
    )
    return cast(Any, ndimage.label(grid.clearance > radius))[0], grid.origin


def regions_at(regions: np.ndarray, origin: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Labels (N, 9) of the cells around each point, since a point may lie beside its own cell."""
    cells = np.round((points - origin) / CELL).astype(int)
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(9, 2)
    cells = np.clip(cells[:, None] + around, 0, np.array(regions.shape) - 1)
    return regions[cells[..., 0], cells[..., 1]]
