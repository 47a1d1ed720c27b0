"""Text plans: floor plans drawn with characters, read as MJCF."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from pecjax.envs.rooms.maps import MAX_WALLS
from pecjax.errors import InputError

SUFFIX = ".txt"  # what a plan's file is told by
WALL, START, GOAL, FREE = "#", "S", "G", ". "
COMMENT = "//"
CELL, HEIGHT = 1.0, 2.5  # m, where a plan says nothing
MAX_CELLS = 2**20
_LENGTHS = {"cell": CELL, "height": HEIGHT}
_MAX_LENGTH = 100  # m
_HEADER = re.compile(r"\s*([a-z]+)\s*[:=]?\s*(\S+)\s*")


def read_text_plan(path: Path, text: str) -> mujoco.MjSpec:
    """The walls of a plan as boxes, its starts and goals as sites, without a drone.

    `#` is wall, `.` and blanks are free, `S` is a start, `G` a goal. The lower left corner of the drawing is
    the origin, x grows to the right and y upwards. Lines `cell 1` and `height 2.5` above the drawing
    are the size of a character and the height of the walls in metres. What begins with `//` is ignored.

    Raises:
        InputError: another character, a length that is none, or too much or too little of a drawing.
    """
    rows, lengths = _parse(path, text)
    cell, height = lengths["cell"], lengths["height"]
    width = max(map(len, rows), default=0)
    if len(rows) * width > MAX_CELLS:
        raise InputError(f"{path}: {width} by {len(rows)} characters; {MAX_CELLS:,} is the most")
    drawn = np.array([list(row.ljust(width)) for row in reversed(rows)])  # the lowest row first
    if not np.any(drawn == WALL):
        raise InputError(f"{path}: no wall; draw one with {WALL}")
    rectangles = merge(drawn == WALL)
    if len(rectangles) > MAX_WALLS:
        raise InputError(f"{path}: its walls take more than {MAX_WALLS:,} boxes; draw fewer")
    spec = mujoco.MjSpec()
    spec.modelname = "text plan"
    for number, corners in enumerate(rectangles):
        (bottom, left), (top, right) = np.array(corners) * cell
        spec.worldbody.add_geom(
            name=f"wall_{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[(left + right) / 2, (bottom + top) / 2, height / 2],
            size=[(right - left) / 2, (top - bottom) / 2, height / 2],
            rgba=[0.75, 0.73, 0.7, 1],
        )
    for name, mark in (("start", START), ("goal", GOAL)):
        # As one reads: the highest row first.
        for number, (row, column) in enumerate(sorted(np.argwhere(drawn == mark).tolist(), key=_as_read)):
            place = [(column + 0.5) * cell, (row + 0.5) * cell, 0]
            spec.worldbody.add_site(name=f"{name}_{number}", pos=place, size=[0.1, 0.1, 0.1])
    return spec


def _as_read(cell: Sequence[int]) -> tuple[int, int]:
    return -cell[0], cell[1]


def _parse(path: Path, text: str) -> tuple[list[str], dict[str, float]]:
    """The rows of the drawing, without empty ones around it, and the lengths in m."""
    rows: list[str] = []
    lengths = dict(_LENGTHS)
    known = WALL + START + GOAL + FREE
    for number, line in enumerate(text.splitlines(), 1):
        line = line.rstrip()
        if line.lstrip().startswith(COMMENT):
            continue
        header = _HEADER.fullmatch(line)
        if header and header[1] in _LENGTHS:
            if rows:
                raise InputError(
                    f"{path}, line {number}: '{header[1]}' stands below; write it above the drawing"
                )
            lengths[header[1]] = _length(f"{path}, line {number}", *header.groups())
        elif wrong := [column for column, character in enumerate(line, 1) if character not in known]:
            raise InputError(
                f"{path}, line {number}, column {wrong[0]}: {line[wrong[0] - 1]!r} is no part of a plan; "
                f"{WALL} is wall, {FREE[0]} is free, {START} a start, {GOAL} a goal"
            )
        elif line or rows:
            rows.append(line)
    while rows and not rows[-1]:
        rows.pop()
    return rows, lengths


def _length(place: str, name: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = 0.0
    if not 0 < value <= _MAX_LENGTH:
        raise InputError(f"{place}: {name} is {word[:40]}; give metres above 0, {_MAX_LENGTH} at most")
    return value


def merge(walls: np.ndarray) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Few rectangles that cover all cells that are walls, and no other; they may overlap.

    Args:
        walls: (R, C) bool.

    Returns:
        the first row and column of each, and those behind its last.
    """
    left = walls.copy()
    found = []
    while left.any() and len(found) <= MAX_WALLS:
        row, column = np.unravel_index(left.argmax(), left.shape)
        wide = _grown(walls, int(row), int(column))
        (a, b), (c, d) = _grown(walls.T, int(column), int(row))
        tall = (b, a), (d, c)
        best = max((wide, tall), key=lambda corners: int(left[_slices(corners)].sum()))
        left[_slices(best)] = False
        found.append(best)
    return found


def _slices(corners: tuple[tuple[int, int], tuple[int, int]]) -> tuple[slice, slice]:
    (top, left), (bottom, right) = corners
    return slice(top, bottom), slice(left, right)


def _grown(walls: np.ndarray, row: int, column: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """The rectangle around a wall cell that is as wide as its row allows, and then as high."""
    left, right = _run(walls[row], column)
    top, bottom = _run(np.asarray(walls[:, left:right].all(axis=1)), row)
    return (top, left), (bottom, right)


def _run(flags: np.ndarray, at: int) -> tuple[int, int]:
    """The first and the one behind the last of the flags around one that is up, without a gap."""
    before, after = np.flatnonzero(~flags[:at]), np.flatnonzero(~flags[at:])
    return int(before[-1]) + 1 if before.size else 0, at + int(after[0]) if after.size else len(flags)
