"""Tables: rows as text, and CSV files read back."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pecjax.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]


def csv_text(rows: Iterable[Row], header: bool = True) -> str:
    """Rows with the same columns as lines of CSV, a header before them if there are any."""
    text = io.StringIO()
    for number, row in enumerate(rows):
        writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
        if header and number == 0:
            writer.writeheader()
        writer.writerow({key: _plain(value) for key, value in row.items()})
    return text.getvalue()


def markdown_text(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, its first row the head."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def joined_tables(texts: Iterable[str]) -> str:
    """One table of several, with the columns of all: a row of a table that lacks one has an empty field.

    The columns of the longest come first.
    """
    tables = [text.partition("\n") for text in texts]
    headers = sorted({head for head, _, _ in tables if head}, key=lambda head: (-len(head), head))
    if len(headers) < 2:
        return f"{''.join(headers)}\n{''.join(rows for _, _, rows in tables)}"
    columns = list(dict.fromkeys(name for head in headers for name in head.split(",")))
    joined = io.StringIO()
    writer = csv.DictWriter(joined, columns, restval="", lineterminator="\n")
    writer.writeheader()
    for head, _, rows in tables:
        writer.writerows(csv.DictReader(io.StringIO(rows), head.split(",")))
    return joined.getvalue()


def _plain(value: Any) -> Any:
    """Seven digits are all that float32 holds; a missing figure is an empty field."""
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value:.7g}"
    return value


def read_table(path: Path, columns: set[str]) -> pd.DataFrame:
    """Reads a CSV file that must have rows, and these columns of numbers.

    Raises:
        InputError: the file is missing, is no table, or lacks one of them.
    """
    import pandas as pd  # slow to import, and trainings write rows without it

    if not path.is_file():
        raise InputError(f"{path}: missing; the run or study has not got that far, train it to its end")
    try:
        # Both are keys: every digit of α counts, and sets of coordinates named 1 and 01 differ.
        keys = {"alpha": lambda text: float(text or "nan"), "coordinates": str}
        table = pd.read_csv(path, converters=keys)
    except ValueError as error:  # pandas' own errors are of this kind
        raise InputError(f"{path}: not a table ({error}); train again") from error
    numeric = set(table.select_dtypes("number").columns)
    if not columns <= numeric or table.empty:
        lacking = ", ".join(sorted(columns - numeric)) or "rows"
        raise InputError(f"{path}: lacks {lacking}; train again")
    return table
