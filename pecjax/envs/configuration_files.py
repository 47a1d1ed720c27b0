"""Files of configurations: text with a number for every column of a table."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from pecjax.envs import axes
from pecjax.errors import InputError, nearest

Table = TypeVar("Table")
_WORD = re.compile(r"(?!(nan|inf|infinity)$)[a-z_]\w*")  # and no number


class _Row(NamedTuple):
    line: int
    values: list[float]


def read_table(path: Path, kind: type[Table]) -> Table:
    """Reads a table of the class from a file with one configuration a line.

    Numbers are separated by commas or blanks; empty lines and what follows a `#` are ignored. A
    first line with names of columns, with or without a `#`, says which they are and in what order;
    axes that it leaves out have their defaults. Without one a line has the required columns.

    Raises:
        InputError: no such file, an unknown or a missing column, a line with more or fewer numbers
            than columns, a number out of its bounds, or no configuration at all.
    """
    names, rows = _read(path, kind)

    def place(row: int, column: str) -> str:
        return f"{path}, line {rows[row].line}, column {names.index(column) + 1}"

    columns = {name: [row.values[column] for row in rows] for column, name in enumerate(names)}
    return axes.from_columns(kind, columns, place)


def line_of(path: Path, kind: type, row: int) -> int:
    """The line that a row of a table was read from."""
    return _read(path, kind)[1][row].line


def table_text(table: Any) -> str:
    """A file that reads back as the same table.

    Columns that hold nothing but their default are left out, unless their axis is optional.
    """
    known, needed = axes.columns_of(type(table)), axes.required(type(table))
    columns = axes.to_columns(table)
    by_default = {name for name, column in columns.items() if np.all(column == known[name].default)}
    for name in [name for name in columns if name not in needed]:
        if by_default >= set(known[name].columns) and not known[name].optional:
            del columns[name]
    # Nine digits tell all float32 numbers apart.
    formats = ["%d" if np.issubdtype(c.dtype, np.integer) else "%.9g" for c in columns.values()]
    text = io.StringIO()
    np.savetxt(text, np.stack([*columns.values()], axis=-1), formats, ",", header=",".join(columns))
    return text.getvalue()


def _read(path: Path, kind: type) -> tuple[list[str], list[_Row]]:
    """The columns of a file, and its rows in their order."""
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (UnicodeDecodeError, OSError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}); give a text file") from error
    names: list[str] | None = None
    rows: list[_Row] = []
    for number, line in enumerate(lines, 1):
        if names is None and not rows:
            names = _header(path, number, line, kind)
            if names is not None:
                continue
        fields = _fields(line.split("#")[0])
        if fields:
            rows.append(_Row(number, _numbers(path, number, line, fields, names or axes.required(kind))))
    names = names or axes.required(kind)
    if not rows:
        raise InputError(f"{path}: no configurations; write one '{', '.join(names)}' a line")
    return names, rows


def _fields(text: str) -> list[str]:
    return text.replace(",", " ").split()


def _header(path: Path, number: int, line: str, kind: type) -> list[str] | None:
    """The columns that a line names, if it is a header.

    A line of words is one; a comment is one where it has as many words as there are required
    columns, or more, and knows half of them.

    Raises:
        InputError: an unknown column, one that stands twice, or a missing one.
    """
    known, needed = axes.columns_of(kind), axes.required(kind)
    names = [field.lower() for field in _fields(line.strip().removeprefix("#"))]
    if not names or not all(_WORD.fullmatch(name) for name in names):
        return None
    is_comment = line.strip().startswith("#")
    if is_comment and (len(names) < len(needed) or 2 * len(set(names) & set(known)) < len(names)):
        return None
    for column, name in enumerate(names, 1):
        if name not in known or name in names[: column - 1]:
            what = "stands twice" if name in known else f"is unknown{nearest(name, [*known])}"
            raise InputError(
                f"{path}, line {number}, column {column}: '{name[:40]}' {what}; "
                f"the columns are {', '.join(known)}"
            )
    given = [about for about in known.values() if set(about.columns) & set(names)]
    for name in known:
        if name not in names and (name in needed or known[name] in given):
            raise InputError(f"{path}, line {number}: no column {name}; the columns are {', '.join(known)}")
    return names


def _numbers(path: Path, number: int, line: str, fields: list[str], names: list[str]) -> list[float]:
    try:
        values = [float(field) for field in fields]
    except ValueError:
        values = []
    if len(values) != len(names):
        raise InputError(
            f"{path}, line {number}: '{line.strip()[:60]}' is not {len(names)} numbers; "
            f"write {', '.join(names)}"
        )
    return values
