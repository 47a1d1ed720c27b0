"""What the benchmark of samplers measures: figures of each run, and comparisons with uniform sampling."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pecjax.agents import PPO
from pecjax.errors import InputError
from pecjax.storage.tables import Row, read_table
from pecjax.studies.benchmark import CELLS, Cell
from pecjax.studies.comparison import difference, holm, mean_relative, relative, steps_to
from pecjax.studies.measures import BASELINE
from pecjax.studies.statistics import area_under_curve
from pecjax.studies.tables import conditions_of

STEPS = "steps_to_"  # and a threshold
_ENDS = ("goal_ratio", "spl", "unbiased_cvar")  # of the last evaluation
_COLUMNS = {"seed", "iteration", "env_steps", "goal_ratio"}


def first_measure(cell: Cell) -> str:
    """The measure that is tested: the steps to the middle threshold."""
    return _steps(cell.thresholds[1])


def steps_measures(cell: Cell) -> list[str]:
    """The steps to each threshold of the cell."""
    return [_steps(at) for at in cell.thresholds]


def read_cells(folder: Path) -> dict[str, pd.DataFrame]:
    """The results of each cell that the folder has, `CELL/results.csv`, with a column `condition`.

    A cell whose runs all diverged has no rows, and is left out.

    Raises:
        InputError: there is none, or one that is not such a table.
    """
    paths = {name: folder / name / "results.csv" for name in CELLS}
    there = {name: path for name, path in paths.items() if path.is_file() and path.read_text().strip()}
    found = {name: read_table(path, _COLUMNS) for name, path in there.items()}
    if not found:
        missing = f"neither study.json nor CELL/results.csv of {', '.join(CELLS)}"
        raise InputError(f"{folder}: {missing}; give the folder of a study or of the benchmark")
    for table in found.values():
        table["condition"] = conditions_of(table)
    return found


def by_run(results: pd.DataFrame, cell: Cell) -> pd.DataFrame:
    """One row a run: its budget, steps to each threshold, the area under the curve, and how it ended.

    A run that others of its seed have and that is missing, since it diverged, has no curve: it never reached
    a threshold.
    """
    budget = float(results.env_steps.max())
    rows = []
    for _, run in results.groupby(["condition", "seed"], sort=False):
        steps, ratios = run.env_steps.to_numpy(), run[cell.measured].to_numpy()
        row = run[["condition", "seed"]].iloc[0].to_dict() | {"budget": budget}
        row |= {_steps(at): steps_to(steps, ratios, at, budget) for at in cell.thresholds}
        row |= {"area": area_under_curve(steps, ratios)}
        ends = [name for name in run.columns if name in _ENDS or name.startswith("goal_ratio.")]
        rows.append(row | {name: run[name].iloc[-1] for name in ends})
    there = pd.DataFrame(rows)
    every = pd.MultiIndex.from_product([there.condition.unique(), sorted(there.seed.unique())])
    whole = there.set_index(["condition", "seed"]).reindex(every.set_names(["condition", "seed"]))
    never = {"budget": budget} | dict.fromkeys(steps_measures(cell), budget)
    return whole.fillna(never).reset_index()


def compare(runs: Mapping[str, pd.DataFrame]) -> list[Row]:
    """One row a cell, condition and measure, beside uniform sampling of the same seeds.

    Steps are compared as ratios (`comparison.relative`), all else by the mean difference. `p_holm` corrects
    the p values of all first measures, the steps to the cells' middle thresholds, together.
    """
    rows = [row for name, table in runs.items() for row in _of_cell(name, CELLS[name], table)]
    first = [row for row in rows if row["first"]]
    corrected_p = holm(np.array([row["p"] for row in first]))
    for row, corrected in zip(first, corrected_p, strict=True):
        row["p_holm"] = float(corrected)
    return rows


def compare_together(runs: Mapping[str, pd.DataFrame]) -> list[Row]:
    """One row a condition: steps to the middle thresholds over uniform ones, the mean of the cells under PPO.

    Conditions that one of these cells lacks are left out; where there is one cell, all are.
    """
    cells = {name: table for name, table in runs.items() if isinstance(CELLS[name].agent, PPO)}
    tables = [
        table.pivot(index="seed", columns="condition", values=first_measure(CELLS[name]))
        for name, table in cells.items()
    ]
    if len(tables) < 2 or min(map(len, tables)) < 2:
        return []
    shared = [name for name in tables[0] if name != BASELINE and all(name in table for table in tables)]
    return [
        {"cell": "mean under PPO", "condition": name}
        | mean_relative([(table[name].to_numpy(), table[BASELINE].to_numpy()) for table in tables])._asdict()
        for name in shared
    ]


def _of_cell(name: str, cell: Cell, runs: pd.DataFrame) -> Iterator[Row]:
    groups = runs.groupby("condition", sort=False)
    by_condition = {
        str(condition): rows.drop(columns="condition").set_index("seed") for condition, rows in groups
    }
    if BASELINE not in by_condition:
        raise InputError(f"{name}: there are no runs of {BASELINE}, which all others are compared with")
    theirs = by_condition[BASELINE]
    for condition, ours in by_condition.items():
        for measure in ours.columns.drop("budget"):
            both = ours[measure].notna() & theirs[measure].notna()
            values, others = ours[measure][both].to_numpy(), theirs[measure][both].to_numpy()
            if not len(values):
                continue
            compared = relative if measure.startswith(STEPS) else difference
            head = {"cell": name, "condition": condition, "measure": measure}
            head |= {"first": condition != BASELINE and measure == first_measure(cell)}
            yield (
                head | {"mean": float(values.mean())} | compared(values, others)._asdict() | {"p_holm": None}
            )


def _steps(threshold: float) -> str:
    return f"{STEPS}{threshold:g}"
