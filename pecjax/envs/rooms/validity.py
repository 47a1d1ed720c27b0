"""Validity: whether the drone can fly every configuration of a table in a map."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.config import Configurations, row_name
from pecjax.envs.rooms.scene import Scene
from pecjax.errors import InputError

CELL = 0.05  # m, of the grid on which reachability is decided
MAX_CELLS = 2**23


def check_coordinates(
    scene: Scene, table: Configurations, *, flight_height: float, source: str | Path | None = None
) -> None:
    """Makes sure that every configuration can be flown.

    Start and goal must lie inside the map and clear of its walls by the drone's radius, differ,
    and be joined by a path that the drone's sphere fits through at its flight height.

    Args:
        flight_height: m.
        source: what `load_coordinates` read the table from, for messages.

    Raises:
        InputError: a row that cannot be flown, with the point at fault.
    """
    start, goal = np.asarray(table.start), np.asarray(table.goal)
    low, high = scene.bounds
    for role, points in (("start", start), ("goal", goal)):
        for row in _first(np.any((points < low) | (points > high), axis=1)):
            raise InputError(
                f"{row_name(source, row)}: {role} {_at(points[row])} lies outside the map; move it"
            )
        heights = np.full((len(points), 1), flight_height, points.dtype)
        gaps = np.asarray(wall_distance(scene, jnp.asarray(np.hstack([points, heights]))))
        for row in _first(gaps <= scene.drone_radius):
            where = "inside a wall" if gaps[row] == 0 else f"{gaps[row]:.2f} m from a wall"
            raise InputError(
                f"{row_name(source, row)}: {role} {_at(points[row])} lies {where}; keep it "
                f"more than {scene.drone_radius:g} m, the drone's radius, away"
            )
    for row in _first(np.all(start == goal, axis=1)):
        raise InputError(f"{row_name(source, row)}: start and goal are both {_at(start[row])}; move one")
    regions, origin = free_regions(scene, flight_height)
    from_start, from_goal = (regions_at(regions, origin, points) for points in (start, goal))
    meet = (from_start[:, :, None] == from_goal[:, None, :]) & (from_start[:, :, None] > 0)
    for row in _first(~meet.any(axis=(1, 2))):
        raise InputError(
            f"{row_name(source, row)}: no path of {2 * scene.drone_radius:g} m width leads from "
            f"{_at(start[row])} to {_at(goal[row])}; widen a door or move a point"
        )


def _first(wrong: np.ndarray) -> list[int]:
    return [int(wrong.argmax())] if wrong.any() else []


def _at(point: np.ndarray) -> str:
    return f"({point[0]:g}, {point[1]:g})"


def free_regions(scene: Scene, flight_height: float) -> tuple[np.ndarray, np.ndarray]:
    """Labels the places that the drone's centre may take, one number per connected region.

    Returns:
        (X, Y) int labels, 0 where the drone does not fit, and (2,) m, the place of cell (0, 0);
        cells are `CELL` metres apart.

    Raises:
        InputError: the map is too large for that.
    """
    low, high = scene.bounds
    if np.prod((high - low) / CELL) > MAX_CELLS:
        raise InputError(
            f"the map is {high[0] - low[0]:g} by {high[1] - low[1]:g} m; "
            f"{MAX_CELLS * CELL**2:,.0f} m² is the most that paths are looked for on"
        )
    xs, ys = (np.arange(low[axis], high[axis] + CELL, CELL) for axis in range(2))
    points = np.stack(np.meshgrid(xs, ys, [flight_height], indexing="ij"), axis=-1)[:, :, 0]
    distance = np.asarray(wall_distance(scene, jnp.asarray(points, jnp.float32)))
    return cast(Any, ndimage.label(distance > scene.drone_radius))[0], np.array([xs[0], ys[0]])


def regions_at(regions: np.ndarray, origin: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Labels (N, 9) of the cells around each point, since a point may lie beside its own cell."""
    cells = np.round((points - origin) / CELL).astype(int)
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(9, 2)
    cells = np.clip(cells[:, None] + around, 0, np.array(regions.shape) - 1)
    return regions[cells[..., 0], cells[..., 1]]
