"""The tables of a study's report in Markdown: how each condition ended, and how it differs in pairs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pecjax.storage import files
from pecjax.studies.grid import shown_space

_NAMES = {
    "goal_ratio": "goal ratio at the end",
    "cvar": "worst tenth at the end",
    "area_under_curve": "goal ratio, area under the curve",
    "cvar_area_under_curve": "worst tenth, area under the curve",
    "training_goal_ratio": "in training: goal ratio, last 100 iterations",
    "failure_ratio": "in training: failure ratio",
    "least_trial_ratio": "in training: least share of trials",
    "greatest_trial_ratio": "in training: greatest share of trials",
}
_PREFIXES = {"steps_to_": "million steps until {} is held", "exit_at_": "million steps to the exit at {}"}
_MEDIAN = "_median"  # after the name of a measure in steps


def report_text(summaries: Sequence[files.Row], differences: Sequence[files.Row]) -> str:
    """A part for each space, with a table of all its conditions and what they differ by from the baseline.

    Ratios are interquartile means over seeds with intervals, steps medians with the least and the greatest,
    and differences means over pairs with intervals and p. Where one condition is compared with the baseline,
    the difference stands in the same table, else each comparison has a table below.

    Args:
        summaries: rows of `report.summary`.
        differences: rows of `report.paired`.
    """
    parts = []
    for space in dict.fromkeys(row["coordinates"] for row in summaries):
        ended = [row for row in summaries if row["coordinates"] == space]
        pairs: dict[tuple[str, str], dict[str, files.Row]] = {}
        for row in differences:
            if row["coordinates"] == space:
                pairs.setdefault((row["condition"], row["baseline"]), {})[row["measure"]] = row
        seeds = max(row["seeds"] for row in ended)
        head = f"## {shown_space(space)}: {seeds} seed{'s' * (seeds > 1)}"
        parts.append("\n".join([f"{head}\n", *_tables(ended, pairs)]))
    return "\n".join(parts)


def _tables(ended: Sequence[files.Row], pairs: dict[tuple[str, str], dict[str, files.Row]]) -> list[str]:
    measures = _measures(ended[0])
    head = ["", *(str(row["condition"]) for row in ended)]
    rows = {name: [_name(name), *(_at_the_end(row, name) for row in ended)] for name in measures}
    if len(pairs) != 1:
        tables = [files.markdown_text(head, rows.values())]
        for names, compared in pairs.items():
            lines = [[_name(name), *_difference(row)] for name, row in compared.items()]
            tables.append(files.markdown_text(["", *_heads(*names)], lines))
        return tables
    ((names, compared),) = pairs.items()
    beside = {name: _difference(compared[name]) if name in compared else [""] * 3 for name in measures}
    return [files.markdown_text(head + _heads(*names), [rows[name] + beside[name] for name in measures])]


def _measures(summary: files.Row) -> list[str]:
    """The measures of a row of `report.summary`, in its order."""
    return [
        name.removesuffix(_MEDIAN) for name in summary if name.endswith(_MEDIAN) or f"{name}_low" in summary
    ]


def _name(measure: str) -> str:
    for prefix, text in _PREFIXES.items():
        if measure.startswith(prefix):
            return text.format(measure.removeprefix(prefix))
    return _NAMES.get(measure) or f"{measure.removeprefix('goal_ratio.')} at the end"


def _at_the_end(row: files.Row, name: str) -> str:
    if f"{name}{_MEDIAN}" not in row:
        return _with_interval(row, name, "{:.3f}")
    median, least, greatest = (row[f"{name}_{which}"] / 1e6 for which in ("median", "min", "max"))
    there, every = row[f"{name}_reached"], row["seeds"]
    among = "" if there == every else f", {there} of {every} runs"
    return "never" if not there else f"{_millions(median)} ({_millions(least)}-{_millions(greatest)}){among}"


def _millions(steps: float) -> str:
    return f"{steps:.2f}" if np.isfinite(steps) else "never"


def _heads(condition: str, baseline: str) -> list[str]:
    return ["better / equal / worse", f"{condition} - {baseline}", "p"]


def _difference(row: files.Row) -> list[str]:
    counts = [row[which] for which in ("better", "equal", "worse")]
    if row["measure"].startswith(tuple(_PREFIXES)):
        of = {name: value / 1e6 for name, value in row.items() if name.startswith("difference")}
        found = _with_interval(of, "difference", "{:+.2f}")
    else:
        found = _with_interval(row, "difference", "{:+.3f}")
    over = f" over {row['pairs']} pairs" if found and row["pairs"] < sum(counts) else ""
    p = "" if np.isnan(row["p"]) else f"{row['p']:.2g}"
    return [" / ".join(map(str, counts)), found + over, p]


def _with_interval(row: files.Row, name: str, figure: str) -> str:
    """The value, with its interval where there is one; nothing where there is no value."""
    value, low, high = (row[key] for key in (name, f"{name}_low", f"{name}_high"))
    if np.isnan(value):
        return ""
    ends = "" if np.isnan(low) else f" [{figure.format(low)}, {figure.format(high)}]"
    return figure.format(value) + ends
