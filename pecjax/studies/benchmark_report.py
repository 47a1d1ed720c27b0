"""The report of the benchmark of samplers: every number of it, from the results of its studies alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pecjax.errors import InputError
from pecjax.storage import files
from pecjax.storage.tables import read_table
from pecjax.studies.benchmark import CELLS, Cell
from pecjax.studies.comparison import difference, holm, relative, steps_to
from pecjax.studies.report import BASELINE
from pecjax.studies.shares import KINDS, mean_shares, read_shares
from pecjax.studies.statistics import area_under_curve
from pecjax.studies.tables import conditions_of

_STEPS = "steps_to_"
_ENDS = ("goal_ratio", "spl", "unbiased_cvar")  # of the last evaluation
_COLUMNS = {"seed", "iteration", "env_steps", "goal_ratio"}


def read_cells(folder: Path) -> dict[str, pd.DataFrame]:
    """The results of each cell that the folder has, `CELL/results.csv`, with a column `condition`.

    Raises:
        InputError: there is none, or one that is not such a table.
    """
    paths = {name: folder / name / "results.csv" for name in CELLS}
    found = {name: read_table(path, _COLUMNS) for name, path in paths.items() if path.is_file()}
    if not found:
        raise InputError(f"{folder}: no CELL/results.csv of {', '.join(CELLS)}; give the benchmark's folder")
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
    never = {"budget": budget} | {_steps(at): budget for at in cell.thresholds}
    return whole.fillna(never).reset_index()


def compare(runs: Mapping[str, pd.DataFrame]) -> list[files.Row]:
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


def _of_cell(name: str, cell: Cell, runs: pd.DataFrame) -> Iterator[files.Row]:
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
            compared = relative if measure.startswith(_STEPS) else difference
            head = {"cell": name, "condition": condition, "measure": measure}
            head |= {"first": condition != BASELINE and measure == _steps(cell.thresholds[1])}
            yield (
                head | {"mean": float(values.mean())} | compared(values, others)._asdict() | {"p_holm": None}
            )


def table(name: str, runs: pd.DataFrame, compared: list[files.Row]) -> str:
    """A cell's table in Markdown: how each condition ended, and its steps beside those of uniform ones."""
    cell = CELLS[name]
    measures = ["goal_ratio", *([] if cell.measured == "goal_ratio" else [cell.measured]), "area"]
    names = {"goal_ratio": "goal ratio at the end", "area": "area under the curve"}
    steps = [_steps(at) for at in cell.thresholds]
    heads = ["", *(names.get(m, f"{m.removeprefix('goal_ratio.')} at the end") for m in measures)]
    heads += [f"million steps to {at:g}" for at in cell.thresholds]
    heads += [f"steps to {cell.thresholds[1]:g}, over uniform", "p", "p (Holm)"]
    found = {(row["condition"], row["measure"]): row for row in compared if row["cell"] == name}
    budget = float(runs.budget.iloc[0])
    lines = [heads, ["---"] * len(heads)]
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
    return _markdown(lines)


def scores(compared: list[files.Row]) -> str:
    """A table in Markdown: steps to the thresholds over uniform ones, by cell, and their mean.

    Means, over a cell's thresholds and over cells, are geometric, the least come first, and conditions that a
    cell lacks are left out.
    """
    steps = pd.DataFrame([row for row in compared if row["measure"].startswith(_STEPS)])
    steps = steps[steps.condition != BASELINE].assign(log=np.log1p(steps.value))
    logs = steps.pivot_table("log", "condition", "cell", sort=False).dropna()
    ordered = np.expm1(logs.assign(mean=logs.mean(axis=1)).sort_values("mean", kind="stable"))
    lines = [["", *(str(name) for name in ordered.columns)], ["---"] * (1 + len(ordered.columns))]
    lines += [[str(name), *(f"{value:+.0%}" for value in row)] for name, row in ordered.iterrows()]
    return _markdown(lines)


def spent(cell: Cell, runs: pd.DataFrame, compared: list[files.Row], shares: pd.DataFrame) -> str:
    """A table in Markdown: where steps went until half of the uniform runs had the middle threshold.

    κ is the share of what is learnable over that share of uniform sampling. If nothing else taught anything,
    and every step of it the same, then 1/κ of the steps would be needed.

    Args:
        runs: of `by_run`.
        compared: of `compare`, the rows of the cell.
        shares: rows of `shares.csv`.
    """
    middle = _steps(cell.thresholds[1])
    until = runs[runs.condition == BASELINE][middle].median()
    along = mean_shares(shares.loc[shares.env_steps <= max(until, shares.env_steps.min())])
    groups = along.groupby("condition", sort=False)
    means = {str(condition): rows[[*KINDS]].to_numpy().mean(axis=0) for condition, rows in groups}
    learnable = KINDS.index("learnable")
    found = {row["condition"]: row["value"] for row in compared if row["first"] and row["measure"] == middle}
    heads = ["", *(kind.replace("_", " ") for kind in KINDS), "κ", "1/κ - 1", "steps, over uniform"]
    lines = [heads, ["---"] * len(heads)]
    for condition, of in means.items():
        kappa = of[learnable] / means[BASELINE][learnable]
        line = [condition, *(f"{share:.2f}" for share in of), f"{kappa:.2f}", f"{1 / kappa - 1:+.0%}"]
        lines.append([*line, f"{found[condition]:+.0%}" if condition in found else ""])
    return _markdown(lines)


def chance(runs: Mapping[str, pd.DataFrame]) -> str:
    """A table in Markdown: how far the conditions of each cell differ, and would if all of them were alike.

    Standard deviations of the logarithm of steps to the middle threshold: of the runs of one condition, of
    means over seeds if only chance told them apart, and of the means that were found.
    """
    lines = [["", "one run", "means, by chance", "means, found"], ["---"] * 4]
    for name, table in runs.items():
        logs = np.log(
            table.pivot(index="condition", columns="seed", values=_steps(CELLS[name].thresholds[1]))
        )
        within = float(np.sqrt(logs.var(axis=1).mean()))
        found = float(logs.mean(axis=1).std())
        lines.append([name, *(f"{sd:.2f}" for sd in (within, within / np.sqrt(logs.shape[1]), found))])
    return _markdown(lines)


def _markdown(lines: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


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
    parts = [
        f"## {name}: {seeds[name]} seed{'s' * (seeds[name] > 1)}\n\n{table(name, rows, compared)}"
        for name, rows in runs.items()
    ]
    for name, shares in read_shares(folder, runs).items():
        of_cell = [row for row in compared if row["cell"] == name]
        parts.append(f"## {name}: where steps went\n\n{spent(CELLS[name], runs[name], of_cell, shares)}")
    if any(row["first"] for row in compared):
        several = {name: table for name, table in runs.items() if seeds[name] > 1}
        parts += [f"## By chance\n\n{chance(several)}"] if several else []
        parts.append(f"## All together\n\n{scores(compared)}")
    text = "\n".join(parts)
    every = pd.concat([rows.assign(cell=name) for name, rows in runs.items()], ignore_index=True)
    ordered = every.loc[:, ["cell", *every.columns.drop("cell")]].to_dict("records")
    with files.writing(folder, "the same command writes it once it can"):
        files.replace_file(folder / "runs.csv", files.csv_text(ordered))
        files.replace_file(folder / "comparisons.csv", files.csv_text(compared))
        files.replace_file(folder / "report.md", text)
    return text


def _steps(threshold: float) -> str:
    return f"{_STEPS}{threshold:g}"
