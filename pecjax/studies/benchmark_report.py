"""The report of the benchmark of samplers: every number of it, from the results of its studies alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pecjax.storage import files
from pecjax.storage.tables import Row, csv_text, markdown_text
from pecjax.studies.benchmark import CELLS, Cell
from pecjax.studies.benchmark_measures import (
    STEPS,
    by_run,
    compare,
    compare_together,
    first_measure,
    read_cells,
    steps_measures,
)
from pecjax.studies.measures import BASELINE
from pecjax.studies.shares import KINDS, mean_shares, read_shares

_SPENT = "Where steps went until half of the uniform runs had the middle threshold, or to the end:"


def table(name: str, runs: pd.DataFrame, compared: list[Row]) -> str:
    """A cell's table in Markdown: how each condition ended, and its steps beside those of uniform ones."""
    cell = CELLS[name]
    measures = ["goal_ratio", *([] if cell.measured == "goal_ratio" else [cell.measured]), "area"]
    names = {"goal_ratio": "goal ratio at the end", "area": "area under the curve"}
    steps = steps_measures(cell)
    heads = ["", *(names.get(m, f"{m.removeprefix('goal_ratio.')} at the end") for m in measures)]
    heads += [f"million steps to {at:g}" for at in cell.thresholds]
    heads += [f"steps to {cell.thresholds[1]:g}, over uniform", "p", "p (Holm)"]
    found = {(row["condition"], row["measure"]): row for row in compared if row["cell"] == name}
    budget = float(runs.budget.iloc[0])
    lines = []
    for condition, rows in runs.groupby("condition", sort=False):
        first = found[condition, steps[1]]
        line = [str(condition), *(f"{rows[m].mean():.3f}" for m in measures)]
        line += [_reached(rows[name].to_numpy(), budget) for name in steps]
        if condition == BASELINE:
            line += ["", "", ""]
        else:
            over = f"{first['value']:+.0%} [{first['low']:+.0%}, {first['high']:+.0%}]"
            line += [over, f"{first['p']:.2g}", f"{first['p_holm']:.2g}"]
        lines.append(line)
    return markdown_text(heads, lines)


def in_short(compared: list[Row], together: list[Row]) -> str:
    """Two tables in Markdown, a row a condition and a column a cell, with 95 % intervals.

    First the steps to the middle thresholds over those of uniform sampling, then what the cells measure at
    the end less that of uniform sampling.

    Args:
        compared: of `compare`.
        together: of `compare_together`, another column of the first table.
    """
    rows = pd.DataFrame([row for row in compared if row["condition"] != BASELINE])
    ends = rows.loc[rows.measure == rows.cell.map(lambda name: CELLS[name].measured)]
    firsts = pd.concat([rows.loc[rows["first"]], pd.DataFrame(together)])
    steps = _by_cell("steps, over uniform", firsts, "{:+.0%}")
    return f"{steps}\n{_by_cell('at the end, less uniform', ends, '{:+.2f}')}"


def _by_cell(head: str, rows: pd.DataFrame, figure: str) -> str:
    text = f"{figure} [{figure}, {figure}]"
    texts = [text.format(*of) for of in zip(rows.value, rows.low, rows.high, strict=True)]
    table = rows.assign(text=texts).pivot_table("text", "condition", "cell", aggfunc="first", sort=False)
    lines = [[str(name), *of] for name, of in table.fillna("").iterrows()]
    return markdown_text([head, *(str(name) for name in table.columns)], lines)


def scores(compared: list[Row]) -> str:
    """A table in Markdown: steps to the thresholds over uniform ones, by cell, and their mean.

    Means, over a cell's thresholds and over cells, are geometric, the least come first, and conditions that a
    cell lacks are left out.
    """
    steps = pd.DataFrame([row for row in compared if row["measure"].startswith(STEPS)])
    steps = steps[steps.condition != BASELINE].assign(log=np.log1p(steps.value))
    logs = steps.pivot_table("log", "condition", "cell", sort=False).dropna()
    ordered = np.expm1(logs.assign(mean=logs.mean(axis=1)).sort_values("mean", kind="stable"))
    lines = [[str(name), *(f"{value:+.0%}" for value in row)] for name, row in ordered.iterrows()]
    return markdown_text(["", *(str(name) for name in ordered.columns)], lines)


def spent(cell: Cell, runs: pd.DataFrame, compared: list[Row], shares: pd.DataFrame) -> str:
    """A table in Markdown: where steps went until half of the uniform runs had the middle threshold.

    κ is the share of what is learnable over that share of uniform sampling. If nothing else taught anything,
    and every step of it the same, then 1/κ of the steps would be needed.

    Args:
        runs: of `by_run`.
        compared: of `compare`, the rows of the cell.
        shares: rows of `shares.csv`.
    """
    middle = first_measure(cell)
    until = runs[runs.condition == BASELINE][middle].median()
    along = mean_shares(shares.loc[shares.env_steps <= max(until, shares.env_steps.min())])
    groups = along.groupby("condition", sort=False)
    means = {str(condition): rows[[*KINDS]].to_numpy().mean(axis=0) for condition, rows in groups}
    learnable = KINDS.index("learnable")
    found = {row["condition"]: row["value"] for row in compared if row["first"] and row["measure"] == middle}
    heads = ["", *(kind.replace("_", " ") for kind in KINDS), "κ"]
    heads += ["steps over uniform, by κ", "steps over uniform, measured"]
    lines = []
    for condition, of in means.items():
        kappa = of[learnable] / means[BASELINE][learnable]
        line = [condition, *(f"{share:.2f}" for share in of), f"{kappa:.2f}", f"{1 / kappa - 1:+.0%}"]
        lines.append([*line, f"{found[condition]:+.0%}" if condition in found else ""])
    return markdown_text(heads, lines)


def chance(runs: Mapping[str, pd.DataFrame]) -> str:
    """A table in Markdown: how far the conditions of each cell differ, and would if all of them were alike.

    Standard deviations of the logarithm of steps to the middle threshold: of the runs of one condition, of
    means over seeds if only chance told them apart, and of the means that were found.
    """
    lines = []
    for name, table in runs.items():
        logs = np.log(table.pivot(index="condition", columns="seed", values=first_measure(CELLS[name])))
        within = float(np.sqrt(logs.var(axis=1).mean()))
        found = float(logs.mean(axis=1).std())
        lines.append([name, *(f"{sd:.2f}" for sd in (within, within / np.sqrt(logs.shape[1]), found))])
    return markdown_text(["", "one run", "means, by chance", "means, found"], lines)


def _reached(steps: np.ndarray, budget: float) -> str:
    """The median, and in how many runs where it is not all."""
    there = int((steps < budget).sum())
    median = f"{np.median(steps) / 1e6:.2f}" if np.median(steps) < budget else "never"
    return median if there == len(steps) else f"{median} ({there} of {len(steps)})"


def write_benchmark_report(folder: Path) -> str:
    """Writes `runs.csv`, `comparisons.csv` and `report.md` into the folder; returns the last.

    Raises:
        InputError: the folder has no results of the benchmark, or cannot be written.
    """
    runs = {name: by_run(results, CELLS[name]) for name, results in read_cells(folder).items()}
    compared = compare(runs)
    seeds = {name: table.seed.nunique() for name, table in runs.items()}
    shares = read_shares(folder, runs)
    parts = []
    for name, rows in runs.items():
        text = f"## {name}: {seeds[name]} seed{'s' * (seeds[name] > 1)}\n\n{table(name, rows, compared)}"
        if name in shares:
            of_cell = [row for row in compared if row["cell"] == name]
            text += f"\n{_SPENT}\n\n{spent(CELLS[name], rows, of_cell, shares[name])}"
        parts.append(text)
    if any(row["first"] for row in compared):
        parts.append(f"## In short\n\n{in_short(compared, compare_together(runs))}")
        several = {name: table for name, table in runs.items() if seeds[name] > 1}
        parts += [f"## By chance\n\n{chance(several)}"] if several else []
        parts.append(f"## All together\n\n{scores(compared)}")
    text = "\n".join(parts)
    every = pd.concat([rows.assign(cell=name) for name, rows in runs.items()], ignore_index=True)
    ordered = every.loc[:, ["cell", *every.columns.drop("cell")]].to_dict("records")
    with files.writing(folder, "the same command writes it once it can"):
        files.replace_file(folder / "runs.csv", csv_text(ordered))
        files.replace_file(folder / "comparisons.csv", csv_text(compared))
        files.replace_file(folder / "report.md", text)
    return text
