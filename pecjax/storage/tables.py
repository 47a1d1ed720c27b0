"""Tables: CSV files read back."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from pecjax.errors import InputError


def read_table(path: Path, columns: set[str]) -> pd.DataFrame:
    """Reads a CSV file that must have rows, and these columns of numbers.

    Raises:
        InputError: the file is missing, is no table, or lacks one of them.
    """
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
