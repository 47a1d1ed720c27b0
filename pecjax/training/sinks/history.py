"""Rows as trackers take them: those that a run already has, and the figures of one by name."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path

from pecjax.storage.tables import Row

POSITION = ("iteration", "env_steps")  # the columns that say where a row stands
_TIMES = ("seconds",)  # of metrics.csv alone; trackers have clocks of their own


def past_rows(folder: Path) -> Iterator[tuple[str, Row]]:
    """Table and row of all that the tables in a run's folder hold, by iteration."""
    found = [
        (int(row["iteration"]), order, table, row)
        for order, table in enumerate(("metrics", "evaluation"))
        for row in _read(folder / f"{table}.csv")
    ]
    for _, _, table, row in sorted(found, key=lambda one: one[:2]):
        numbers = {name: float(text or "nan") for name, text in row.items() if name not in _TIMES}
        yield table, numbers | {name: int(row[name]) for name in POSITION}


def _read(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def scalars(table: str, row: Row) -> dict[str, float]:
    """The figures of a row, as `table/column`; those that are not known (NaN) are left out."""
    figures = {name: float(value) for name, value in row.items() if name not in POSITION}
    return {f"{table}/{name}": value for name, value in figures.items() if not math.isnan(value)}
