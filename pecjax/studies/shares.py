"""Shares: how much of a training was spent on what was mastered, could be learned, or was out of reach."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from pecjax.storage import files
from pecjax.storage.tables import csv_text, read_table
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.tables import conditions_of

REACH = 0.1  # as far from 0 or 1 as this, an expected goal ratio still counts as it
KINDS = ("out_of_reach", "learnable", "mastered")


def kinds_of(trials: np.ndarray, failures: np.ndarray) -> np.ndarray:
    """The kind (V, N) of each configuration between two evaluations, as a number of `KINDS`.

    By its goal ratio over all runs of a study meanwhile, of all samplers: one run alone flies a configuration
    too seldom to tell. One flip of either outcome is added (Laplace 1814), so that what was hardly flown is
    learnable.

    Args:
        trials, failures: (R, V, N), between two evaluations.
    """
    tried, failed = trials.sum(axis=0), failures.sum(axis=0)
    ratios = (tried - failed + 1) / (tried + 2)
    return np.digitize(ratios, [REACH, 1 - REACH])


def shares(steps: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """Of the steps (R, V, N) of each run between two evaluations, the share (R, V, 3) of each kind (V, N)."""
    of_kind = [np.where(kinds == kind, steps, 0).sum(axis=-1) for kind in range(len(KINDS))]
    return np.stack(of_kind, axis=-1) / np.maximum(steps.sum(axis=-1), 1)[..., None]


def write_shares(folder: Path) -> None:
    """Writes `shares.csv` into a study's folder: a row a run and evaluation."""
    directory = StudyDirectory(folder)
    tables, counts = [], []
    for path, arrays in directory.configurations(len(directory.settings().batches())):
        if arrays["trials"].size and "steps" in arrays:  # neither all diverged nor of a version without steps
            tables.append(read_table(path / "results.csv", {"seed", "iteration", "env_steps"}))
            counts.append(np.stack([arrays[name] for name in ("trials", "failures", "steps")]))
    if not counts:
        return
    trials, failures, steps = np.diff(np.concatenate(counts, axis=1), axis=2, prepend=0)
    found = shares(steps, kinds_of(trials, failures))  # in the order of the tables' rows
    rows = pd.concat(tables, ignore_index=True)
    rows = rows.assign(condition=conditions_of(rows), **dict(zip(KINDS, found.reshape(-1, 3).T, strict=True)))
    columns = ["condition", "seed", "env_steps", *KINDS]
    files.replace_file(folder / "shares.csv", csv_text(rows.loc[:, columns].to_dict("records")))


def read_shares(folder: Path, cells: Iterable[str]) -> dict[str, pd.DataFrame]:
    """The rows of each cell's `shares.csv`, of those that have one.

    Raises:
        InputError: one is not such a table.
    """
    paths = {name: folder / name / "shares.csv" for name in cells}
    columns = {"env_steps", *KINDS}
    return {name: read_table(path, columns) for name, path in paths.items() if path.is_file()}


def mean_shares(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a condition and evaluation, the means of its runs.

    Args:
        rows: of `shares.csv`.
    """
    return rows.groupby(["condition", "env_steps"], sort=False)[[*KINDS]].mean().reset_index()
