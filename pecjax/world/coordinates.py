"""Coordinates: the paper's two sets, and tables of configurations from files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from pecjax.errors import InputError

MAX_COORDINATE = 1e6  # m; what lies beyond is a typo
COLUMNS = ("start_x", "start_y", "goal_x", "goal_y")  # of a file with a header
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


def row_name(source: str | Path | None, row: int) -> str:
    """What messages call a row of a table that was read from `source`, None for no file."""
    if source is None or str(source) in _SETS:
        return f"configuration {row}"
    return f"{source}, line {_rows(Path(source))[row][0]}: configuration {row}"
