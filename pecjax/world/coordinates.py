"""Coordinates: the paper's two sets, tables of configurations from files, and their checks."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from pecjax.errors import InputError
from pecjax.world.clearance import wall_distance
from pecjax.world.scene import Scene

CELL = 0.05  # m, of the grid on which reachability is decided


class Configurations(NamedTuple):
    """A table of environment configurations, one per row of every leaf.

    A further quantity that varies by episode (wind, mass, a map's number) is a further field.

    Attributes:
        start: (N, 2) m, where the drone begins.
        goal: (N, 2) m, where it must go.
    """

    start: jax.Array | np.ndarray
    goal: jax.Array | np.ndarray

    @property
    def size(self) -> int:
        """N, the number of configurations."""
        return self.start.shape[0]


def _there_and_back(pairs: list[tuple[tuple[float, float], tuple[float, float]]]) -> Configurations:
    both = np.array([leg for start, goal in pairs for leg in ((start, goal), (goal, start))])
    both = both.astype(np.float32)
    return Configurations(start=both[:, 0], goal=both[:, 1])


# Table 1 of Jang & Choi (2022): c0, c2, …; each odd row is the reverse of the even row before it.
# The paper prints c15 the same as c14. Every other pair is a reversal and c15 is reported as the
# hardest of all, so we take it for a misprint and read c15 as (3, -2) -> (3, -5).
COORDINATE_SET_1 = _there_and_back([
    ((0, -2), (5, -2)),
    ((-1, 0), (-1, 4)),
    ((-5, 0), (-5, 5)),
    ((0, 5), (5, 5)),
    ((3, 2), (3, 6)),
    ((-5, -5), (-8, -8)),
    ((-7, -8), (-1, -8)),
    ((3, -5), (3, -2)),
    ((0, -2), (-5, -2)),
    ((-8, -2), (6, -2)),
])  # fmt: skip

# Table 2 of Jang & Choi (2022), the hard set: no pair sees its goal from its start.
COORDINATE_SET_2 = _there_and_back([
    ((-7, -8), (-1, -8)),
    ((-8, -2), (6, -2)),
    ((-1, 3), (0, -5)),
    ((0, 5), (5, -2)),
    ((-1, -2), (5, 5)),
    ((0, -1), (-5, 5)),
    ((-6, -6), (-1, -8)),
    ((5, -7), (2, -1)),
    ((6, -1), (3, -6)),
    ((-7, -6), (-1, -8)),
    ((-5, 5), (0, -2)),
    ((-7, 0), (5, 0)),
])  # fmt: skip

_SETS = {"1": COORDINATE_SET_1, "2": COORDINATE_SET_2}


def load_coordinates(name: str | Path) -> Configurations:
    """Reads a set of coordinates: `1` or `2` for the paper's, else the path of a text file.

    A file has one configuration a line: start x, start y, goal x, goal y in metres, parted by
    commas or blanks; empty lines and what follows a `#` are passed over.

    Raises:
        InputError: no such set or file, a line that is not four finite numbers, or no line at all.
    """
    if str(name) in _SETS:
        return _SETS[str(name)]
    path = Path(name)
    if not path.is_file():
        raise InputError(f"coordinates '{name}': neither 1 nor 2 nor a file; give one of these")
    try:
        lines = path.read_text().splitlines()
    except (UnicodeDecodeError, OSError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}); give a text file") from error
    rows = [_row(path, n, line) for n, line in enumerate(lines, 1) if line.split("#")[0].strip()]
    if not rows:
        raise InputError(f"{path}: no coordinates; write one 'x, y, x, y' a line")
    table = np.array(rows, np.float32)
    return Configurations(start=table[:, :2], goal=table[:, 2:])


def _row(path: Path, number: int, line: str) -> list[float]:
    try:
        row = [float(field) for field in line.split("#")[0].replace(",", " ").split()]
    except ValueError:
        row = []
    if len(row) != 4 or not np.all(np.isfinite(row)):
        raise InputError(
            f"{path}, line {number}: '{line.strip()[:60]}' is not four numbers; "
            "write start x, start y, goal x, goal y in metres"
        )
    return row


def check_coordinates(
    scene: Scene, table: Configurations, *, flight_height: float, goal_radius: float
) -> None:
    """Makes sure that every configuration can be flown.

    Start and goal must lie inside the map and clear of its walls by the drone's radius, differ,
    and be joined by a path that the drone's sphere fits through at its flight height.

    Raises:
        InputError: the first row that cannot be flown, with the point at fault.
    """
    rooms, origin = free_rooms(scene, flight_height)
    for row, (start, goal) in enumerate(zip(np.asarray(table.start), np.asarray(table.goal), strict=True)):
        for role, point in (("start", start), ("goal", goal)):
            where = f"configuration {row}: {role} ({point[0]:g}, {point[1]:g})"
            outside = np.any(point < scene.wall_lower[:, :2].min(axis=0)) or np.any(
                point > scene.wall_upper[:, :2].max(axis=0)
            )
            if outside:
                raise InputError(f"{where} lies outside the map; move it inside")
            gap = float(wall_distance(scene, jnp.append(point, flight_height)))
            if gap < scene.drone_radius:
                place = "inside a wall" if gap == 0 else f"{gap:.2f} m from a wall"
                raise InputError(
                    f"{where} lies {place}; keep {scene.drone_radius:g} m, the drone's radius, away"
                )
        if np.array_equal(start, goal):
            raise InputError(f"configuration {row}: start and goal are both ({start[0]:g}, {start[1]:g})")
        cells = np.indices(rooms.shape).transpose(1, 2, 0) * CELL + origin
        near_goal = np.linalg.norm(cells - goal, axis=-1) < goal_radius
        near_start = np.linalg.norm(cells - start, axis=-1) < 2 * CELL
        if not np.intersect1d(rooms[near_start & (rooms > 0)], rooms[near_goal]).size:
            raise InputError(
                f"configuration {row}: no path of {2 * scene.drone_radius:g} m width leads from "
                f"({start[0]:g}, {start[1]:g}) to ({goal[0]:g}, {goal[1]:g}); widen a door or move a point"
            )


def free_rooms(scene: Scene, flight_height: float) -> tuple[np.ndarray, np.ndarray]:
    """Labels the places that the drone's centre may take, one number per connected region.

    Returns:
        (X, Y) int labels, 0 where the drone does not fit, and (2,) m, the place of cell (0, 0);
        cells are `CELL` metres apart.
    """
    lower = scene.wall_lower[:, :2].min(axis=0)
    upper = scene.wall_upper[:, :2].max(axis=0)
    xs = np.arange(lower[0], upper[0] + CELL, CELL)
    ys = np.arange(lower[1], upper[1] + CELL, CELL)
    points = jnp.stack(jnp.meshgrid(xs, ys, jnp.array([flight_height]), indexing="ij"), axis=-1)[:, :, 0]
    labels, _ = ndimage.label(np.asarray(wall_distance(scene, points)) >= scene.drone_radius)
    return np.asarray(labels), np.array([xs[0], ys[0]])
