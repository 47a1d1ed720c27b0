"""The report of a study: its measures as tables, in words and in Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pecjax.storage import files
from pecjax.storage.tables import Row, csv_text, markdown_text
from pecjax.studies.grid import shown_space
from pecjax.studies.measures import (
    LAST_ITERATIONS,
    RATIOS,
    STEPS,
    THRESHOLDS,
    TRAINING,
    by_run,
    group_columns,
    paired,
    summary,
)
from pecjax.studies.tables import read_study

NAMES = {
    "goal_ratio": "goal ratio at the end",
    "cvar": "worst tenth at the end",
    "area_under_curve": "goal ratio, area under the curve",
    "cvar_area_under_curve": "worst tenth, area under the curve",
    **{f"steps_to_{at:g}": f"million steps until {at:g} is held" for at in THRESHOLDS},
    **{f"exit_at_{at:g}": f"million steps to the exit at {at:g}" for at in THRESHOLDS},
    "training_goal_ratio": f"in training: goal ratio, last {LAST_ITERATIONS} iterations",
    "failure_ratio": "in training: failure ratio",
    "least_trial_ratio": "in training: least share of trials",
    "greatest_trial_ratio": "in training: greatest share of trials",
}


def write_report(folder: Path) -> str:
    """Writes `runs.csv`, `summary.csv`, `paired.csv` and `report.md`; returns the gist of them in words.

    Raises:
        InputError: the study has gathered no tables, or its folder cannot be written.
    """
    runs = by_run(read_study(folder))
    summaries, differences = list(summary(runs)), list(paired(runs))
    exact = [None if np.isnan(alpha) else files.exact_text(alpha) for alpha in runs.alpha]
    written = {
        "runs": runs.assign(alpha=exact).to_dict("records"),
        "summary": summaries,
        "paired": differences,
    }
    with files.writing(folder, "the same command resumes once it can"):
        for name, rows in written.items():
            files.replace_file(folder / f"{name}.csv", csv_text(rows))
        files.replace_file(folder / "report.md", markdown_report(summaries, differences, group_columns(runs)))
    return "\n".join(_in_words(summaries, differences))


def _in_words(summaries: Sequence[Row], differences: Sequence[Row]) -> Iterator[str]:
    for row in summaries:
        yield (
            f"{shown_space(row['coordinates'])}, {row['condition']}, {row['seeds']} seeds: goal ratio "
            f"{row['goal_ratio']:.3f} [{row['goal_ratio_low']:.3f}, {row['goal_ratio_high']:.3f}], "
            f"worst tenth {row['cvar']:.3f} [{row['cvar_low']:.3f}, {row['cvar_high']:.3f}]; 0.9 held from "
            f"{_millions(row['steps_to_0.9_median'], ' M steps')}, "
            f"0.95 from {_millions(row['steps_to_0.95_median'], ' M steps')}"
        )
    by_measure = {(row["coordinates"], row["condition"], row["measure"]): row for row in differences}
    for coordinates, condition in dict.fromkeys(key[:2] for key in by_measure):
        ratio, steps = (
            by_measure[coordinates, condition, name]
            for name in ("goal_ratio", f"steps_to_{THRESHOLDS[-1]:g}")
        )
        interval_of_ratio = f"[{ratio['difference_low']:+.3f}, {ratio['difference_high']:+.3f}]"
        yield (
            f"{shown_space(coordinates)}, {condition} - {ratio['baseline']}, {ratio['pairs']} pairs: "
            f"goal ratio {ratio['difference']:+.3f} {interval_of_ratio}, p {ratio['p']:.2g}; "
            f"{THRESHOLDS[-1]:g} held sooner in {steps['better']}, alike in {steps['equal']}, "
            f"later in {steps['worse']}"
        )


def markdown_report(summaries: Sequence[Row], differences: Sequence[Row], groups: Sequence[str] = ()) -> str:
    """For each space a table of how its conditions ended, and one of each paired comparison.

    Ratios are interquartile means over seeds with intervals, steps medians with the least and the greatest,
    differences means over pairs with intervals.

    Args:
        summaries: rows of `measures.summary`.
        differences: rows of `measures.paired`.
        groups: the goal ratios of groups among their measures, of `measures.group_columns`.
    """
    parts = []
    for space in dict.fromkeys(row["coordinates"] for row in summaries):
        conditions = [row for row in summaries if row["coordinates"] == space]
        seeds = max(row["seeds"] for row in conditions)
        parts.append(f"## {shown_space(space)}: {seeds} seed{'s' * (seeds > 1)}\n")
        parts.append(_ends(conditions, seeds, groups))
        of_space = [row for row in differences if row["coordinates"] == space]
        for condition, baseline in dict.fromkeys((row["condition"], row["baseline"]) for row in of_space):
            parts.append(f"In pairs, {condition} - {baseline}:\n")
            rows = [row for row in of_space if (row["condition"], row["baseline"]) == (condition, baseline)]
            lines = [[_name(row["measure"]), *_difference(row)] for row in rows]
            parts.append(markdown_text(["", "better / equal / worse", "difference", "p"], lines))
    return "\n".join(parts)


def _ends(conditions: Sequence[Row], seeds: int, groups: Sequence[str]) -> str:
    """How each condition ended; those with fewer seeds, of which runs diverged, say so."""
    heads = [
        row["condition"] if row["seeds"] == seeds else f"{row['condition']} ({row['seeds']} seeds)"
        for row in conditions
    ]
    lines = []
    for name in (*RATIOS, *groups, *STEPS, *TRAINING):
        text = _steps if name in STEPS else _number
        lines.append([_name(name), *(text(row, name) for row in conditions)])
    return markdown_text(["", *heads], lines)


def _name(measure: str) -> str:
    group = measure.partition("goal_ratio.")[2]
    return f"{group} at the end" if group else NAMES[measure]


def _steps(row: Row, name: str) -> str:
    """The median, the least and the greatest; and in how many runs it was reached where it is not all."""
    median, least, greatest = (_millions(row[f"{name}_{which}"]) for which in ("median", "min", "max"))
    reached = row[f"{name}_reached"]
    if not reached:
        return "never"
    among = f", {reached} of {row['seeds']}" if reached < row["seeds"] else ""
    return f"{median} ({least}-{greatest}){among}"


def _difference(row: Row) -> list[str]:
    counts = [row[which] for which in ("better", "equal", "worse")]
    if row["measure"] in STEPS:
        millions = {name: row[name] / 1e6 for name in ("difference", "difference_low", "difference_high")}
        found = _number(millions, "difference", "{:+.2f}")
    else:
        found = _number(row, "difference", "{:+.3f}")
    over = f" over {row['pairs']} pairs" if found and row["pairs"] < sum(counts) else ""
    return [" / ".join(map(str, counts)), found + over, "" if np.isnan(row["p"]) else f"{row['p']:.2g}"]


def _number(row: Row, name: str, form: str = "{:.3f}") -> str:
    """The value, with its interval where there is one; nothing where there is no value."""
    value, low, high = (row[key] for key in (name, f"{name}_low", f"{name}_high"))
    if np.isnan(value):
        return ""
    return form.format(value) + ("" if np.isnan(low) else f" [{form.format(low)}, {form.format(high)}]")


def _millions(steps: float, unit: str = "") -> str:
    return f"{steps / 1e6:.2f}{unit}" if np.isfinite(steps) else "never"
