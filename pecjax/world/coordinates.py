"""Coordinates: the paper's two sets, tables of configurations from files, and their checks."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from pecjax.errors import InputError
from pecjax.world.clearance import wall_distance
from pecjax.world.scene import Scene

MAX_COORDINATE = 1e6  # m; what lies beyond is a typo
COLUMNS = ("start_x", "start_y", "goal_x", "goal_y")  # of a file with a header
CELL = 0.05  # m, of the grid on which reachability is decided
MAX_CELLS = 2**23
_WORD = re.compile(r"(?!(nan|inf|infinity)$)[a-z_]\w*")  # and no number


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

    A file has one configuration a line: start x, start y, goal x, goal y in metres, separated by
    commas or blanks; empty lines and what follows a `#` are ignored. A first line with the names
    start_x, start_y, goal_x and goal_y, with or without a `#`, may give another order.

    Raises:
        InputError: no such set or file, an unknown column, a line that is not four finite numbers,
            or no line at all.
    """
    if str(name) in _SETS:
        return _SETS[str(name)]
    table = np.array([row for _, row in _rows(Path(name))]).astype(np.float32)
    return Configurations(start=table[:, :2], goal=table[:, 2:])


def _rows(path: Path) -> list[tuple[int, list[float]]]:
    """The number of each line that holds a configuration, and its values in the order of `COLUMNS`."""
    if not path.is_file():
        raise InputError(f"coordinates '{path}': neither 1 nor 2 nor a file; give one of these")
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (UnicodeDecodeError, OSError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}); give a text file") from error
    order: list[int] | None = None
    rows: list[tuple[int, list[float]]] = []
    for number, line in enumerate(lines, 1):
        if order is None and not rows:
            order = _header(path, number, line)
            if order is not None:
                continue
        fields = _fields(line.split("#")[0])
        if fields:
            row = _row(path, number, line, fields)
            rows.append((number, row if order is None else [row[column] for column in order]))
    if not rows:
        raise InputError(f"{path}: no coordinates; write one 'x, y, x, y' a line")
    return rows


def _fields(text: str) -> list[str]:
    return text.replace(",", " ").split()


def _header(path: Path, number: int, line: str) -> list[int] | None:
    """Where each of `COLUMNS` stands, if the line is a header.

    A line of words is one; a comment is one where it has four words and knows a column.

    Raises:
        InputError: a header with an unknown column, or without one of them.
    """
    names = [field.lower() for field in _fields(line.strip().removeprefix("#"))]
    is_comment = line.strip().startswith("#")
    if not names or not all(_WORD.fullmatch(name) for name in names):
        return None
    if is_comment and (len(names) != len(COLUMNS) or not set(names) & set(COLUMNS)):
        return None
    for column, name in enumerate(names, 1):
        if name not in COLUMNS or name in names[: column - 1]:
            what = "stands twice" if name in COLUMNS else "is unknown"
            raise InputError(
                f"{path}, line {number}, column {column}: '{name[:40]}' {what}; "
                f"the columns are {', '.join(COLUMNS)}"
            )
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise InputError(f"{path}, line {number}: no column {missing[0]}; write {', '.join(COLUMNS)}")
    return [names.index(name) for name in COLUMNS]


def _row(path: Path, number: int, line: str, fields: list[str]) -> list[float]:
    try:
        row = [float(field) for field in fields]
    except ValueError:
        row = []
    if len(row) != 4 or not np.all(np.abs(row) <= MAX_COORDINATE):
        raise InputError(
            f"{path}, line {number}: '{line.strip()[:60]}' is not four numbers; "
            "write start x, start y, goal x, goal y in metres"
        )
    return row


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

    def named(row: int) -> str:
        if source is None or str(source) in _SETS:
            return f"configuration {row}"
        return f"{source}, line {_rows(Path(source))[row][0]}: configuration {row}"

    start, goal = np.asarray(table.start), np.asarray(table.goal)
    low, high = scene.bounds
    for role, points in (("start", start), ("goal", goal)):
        for row in _first(np.any((points < low) | (points > high), axis=1)):
            raise InputError(f"{named(row)}: {role} {_at(points[row])} lies outside the map; move it")
        heights = np.full((len(points), 1), flight_height, points.dtype)
        gaps = np.asarray(wall_distance(scene, jnp.asarray(np.hstack([points, heights]))))
        for row in _first(gaps <= scene.drone_radius):
            where = "inside a wall" if gaps[row] == 0 else f"{gaps[row]:.2f} m from a wall"
            raise InputError(
                f"{named(row)}: {role} {_at(points[row])} lies {where}; keep it "
                f"more than {scene.drone_radius:g} m, the drone's radius, away"
            )
    for row in _first(np.all(start == goal, axis=1)):
        raise InputError(f"{named(row)}: start and goal are both {_at(start[row])}; move one")
    regions, origin = free_regions(scene, flight_height)
    from_start, from_goal = (regions_at(regions, origin, points) for points in (start, goal))
    meet = (from_start[:, :, None] == from_goal[:, None, :]) & (from_start[:, :, None] > 0)
    for row in _first(~meet.any(axis=(1, 2))):
        raise InputError(
            f"{named(row)}: no path of {2 * scene.drone_radius:g} m width leads from "
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
