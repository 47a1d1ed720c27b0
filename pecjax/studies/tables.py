"""The tables of a study, as its report and its figures take them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pecjax.errors import InputError
from pecjax.storage.tables import read_table
from pecjax.studies.directory import StudyDirectory
from pecjax.training.kinds import label

_COLUMNS = {
    "results": {"seed", "iteration", "env_steps", "goal_ratio", "cvar", "mean_return"},
    "metrics": {"seed", "iteration", "env_steps"},
    "configurations": {"seed", "iteration", "config", "trials", "failures"},
}


class StudyTables(NamedTuple):
    """A study's tables, each with a column `condition`: the sampler and all digits of what it varies."""

    results: pd.DataFrame
    metrics: pd.DataFrame
    configurations: pd.DataFrame


def read_study(folder: Path) -> StudyTables:
    """Reads the tables that a study has gathered so far.

    Raises:
        InputError: there are none, they do not belong together, or two runs in them cannot be told apart.
    """
    directory = StudyDirectory(folder)
    settings = directory.settings()
    alphas = settings.values_of("sampler.alpha")
    in_full = {float(f"{alpha:.7g}"): alpha for alpha in alphas}  # older versions wrote 7 digits
    in_full |= {alpha: alpha for alpha in alphas}
    found = {name: read_table(folder / f"{name}.csv", _COLUMNS[name]) for name in ("results", "metrics")}
    found["configurations"] = _configurations(directory, len(settings.batches()), found["results"])
    for name, table in found.items():
        table["alpha"] = [in_full.get(alpha, alpha) for alpha in table.alpha]
        table["condition"] = conditions_of(table)
        keys = ["coordinates", "condition", "seed", "iteration", *_COLUMNS[name] & {"config"}]
        twice = table.loc[table.duplicated(keys)]
        if len(twice):
            row = twice.iloc[0]
            raise InputError(
                f"{folder / f'{name}.csv'}: coordinates {row.coordinates}, {row.condition}, seed {row.seed} "
                "is there twice; where two α share their first 7 digits, as older versions wrote them, "
                "train the study again in another folder"
            )
    _check_runs(folder, found)
    return StudyTables(**found)


def _check_runs(folder: Path, found: dict[str, pd.DataFrame]) -> None:
    """Makes sure that all tables have the runs that the results have."""
    runs = {
        name: set(table[["coordinates", "condition", "seed"]].itertuples(index=False, name=None))
        for name, table in found.items()
    }
    for name in ("metrics", "configurations"):
        for coordinates, condition, seed in sorted(runs["results"] - runs[name])[:1]:
            raise InputError(
                f"{folder}: of coordinates {coordinates}, {condition}, seed {seed} it has results and no "
                f"{name}; the command that the study was made by makes them again"
            )


def _configurations(directory: StudyDirectory, batches: int, results: pd.DataFrame) -> pd.DataFrame:
    """A row of trials, failures and goal ratio for every run, evaluation and configuration."""
    of_version_0_1 = directory.folder / "configurations.csv"
    if of_version_0_1.is_file():
        return _with_ratios(read_table(of_version_0_1, _COLUMNS["configurations"]), results)
    parts = []
    for path, arrays in directory.configurations(batches):
        try:
            parts.extend(_of_batch(path, arrays))
        except InputError:
            raise
        except (KeyError, ValueError, TypeError) as error:
            what = f"not the arrays of a batch ({error!r}); remove it and resume the study"
            raise InputError(f"{path}: {what}") from error
    if not parts:
        raise InputError(f"{directory.folder / 'batches'}: none is there; resume the study")
    return pd.concat(parts, ignore_index=True)


def _of_batch(path: Path, arrays: dict[str, np.ndarray]) -> Iterator[pd.DataFrame]:
    """The same of each run of one batch."""
    if not arrays["trials"].size:  # every run of it diverged
        return
    of_batch = read_table(path / "results.csv", _COLUMNS["results"])
    heads = of_batch.loc[:, :"iteration"].drop(columns="iteration").drop_duplicates(ignore_index=True)
    for (_, head), trials, failures, ratios in zip(
        heads.iterrows(), arrays["trials"], arrays["failures"], arrays["goal_ratio"], strict=True
    ):
        evaluations, configs = trials.shape
        counts = {
            "iteration": np.repeat(arrays["iteration"], configs),
            "config": np.tile(np.arange(configs), evaluations),
            "trials": trials.ravel(),
            "failures": failures.ravel(),
            "goal_ratio": ratios.ravel(),
        }
        kinds = {"iteration": int, "trials": int, "failures": int, "goal_ratio": float}
        yield pd.DataFrame(head.to_dict() | counts).astype(kinds)


def _with_ratios(counts: pd.DataFrame, results: pd.DataFrame) -> pd.DataFrame:
    """The goal ratios, which version 0.1 kept as columns c0, c1, … of its results."""
    head = list(results.loc[:, :"iteration"].columns)
    ratios = results.melt(head, results.filter(regex=r"^c\d+$").columns, "config", "goal_ratio_")
    ratios["config"] = ratios.config.str.removeprefix("c").astype(int)
    return counts.merge(ratios, "left", [*head, "config"]).rename(columns={"goal_ratio_": "goal_ratio"})


def varied_columns(table: pd.DataFrame) -> list[str]:
    """The columns of settings that a study varies by their dotted paths."""
    return [
        name
        for name in table.columns
        if name.partition(".")[0] in ("sampler", "agent", "task", "ppo", "apex") and "." in name
    ]


def conditions_of(table: pd.DataFrame) -> list[str]:
    """The condition of each row: the sampler and all digits of what a study varies."""
    varied = ["alpha", *varied_columns(table)]
    rows = table[["sampler", *varied]].itertuples(index=False)
    return [_condition(sampler, zip(varied, values, strict=True)) for sampler, *values in rows]


def _condition(sampler: str, values: Iterable[tuple[str, Any]]) -> str:
    return ", ".join(label(sampler, [(path, value) for path, value in values if pd.notna(value)]))
