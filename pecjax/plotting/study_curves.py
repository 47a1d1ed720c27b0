"""Curves of a study: its figures against iteration, with intervals over seeds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pecjax.plotting.style import RATIO_LIMITS, SMOOTHED_ITERATIONS, steps_axis, whole_ticks
from pecjax.studies.report import THRESHOLDS
from pecjax.studies.statistics import interval, trial_and_failure_ratios
from pecjax.studies.tables import StudyTables

# Colours that stay apart in grey with the dashes and marks beside them (Okabe & Ito).
STYLES = (
    ("#0072b2", "-", "o"),
    ("#d55e00", "--", "s"),
    ("#009e73", "-.", "^"),
    ("#333333", ":", "D"),
    ("#cc79a7", (0, (5, 1, 1, 1, 1, 1)), "v"),
    ("#56b4e9", (0, (1, 1)), "P"),
)
INTERVALS = "interquartile mean, 95 % interval over seeds"
FEW = 5  # conditions whose legend has a place within the axes


def style_of(number: int) -> tuple[str, Any, str]:
    """Colour, dashes and mark of the n-th condition; each of 36 has its own."""
    turn, place = divmod(number, len(STYLES))
    _, dashes, mark = STYLES[(place + turn) % len(STYLES)]
    return STYLES[place][0], dashes, mark


def _conditions(table: pd.DataFrame) -> Iterator[tuple[Any, pd.DataFrame, tuple]]:
    by_condition = table.groupby("condition", sort=False)
    for number, (condition, rows) in enumerate(by_condition):
        yield condition, rows, style_of(number)


def _curves(axes: Axes, table: pd.DataFrame, column: str, label: str, marks: bool = False) -> None:
    """A line of interquartile means for each condition, and its interval as a band, paler where many lie."""
    alpha = 0.18 * min(1.0, FEW / table.condition.nunique())
    for condition, rows, (color, dashes, mark) in _conditions(table):
        by_iteration = rows.pivot(index="iteration", columns="seed", values=column).dropna()
        found = np.array([interval(row) for row in by_iteration.to_numpy()])
        if not len(found):
            continue
        style = {"marker": mark, "markersize": 3.5} if marks else {}
        axes.plot(by_iteration.index, found[:, 0], color=color, linestyle=dashes, label=condition, **style)
        axes.fill_between(by_iteration.index, found[:, 1], found[:, 2], color=color, alpha=alpha, linewidth=0)
    axes.set(xlabel="iteration", ylabel=label)
    whole_ticks(axes)
    axes.grid(alpha=0.3)


def _smooth(metrics: pd.DataFrame, most: int = 100) -> pd.DataFrame:
    """Training goal ratios, each the mean of those before it, at no more than so many iterations."""
    every = max(1, metrics.iteration.max() // most)
    by_run = metrics.groupby(["condition", "seed"], sort=False).goal_ratio
    mean = by_run.transform(lambda ratios: ratios.rolling(SMOOTHED_ITERATIONS, min_periods=1).mean())
    return metrics.assign(goal_ratio=mean).loc[metrics.iteration % every == 0]


def goal_ratio(tables: StudyTables) -> Figure:
    """Goal ratio against iteration, in training and on the uniform evaluation (Fig. 4, 8)."""
    figure = Figure((9.6, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _curves(left, _smooth(tables.metrics), "goal_ratio", "goal ratio")
    left.set_title(f"training, the sampler's own draw (mean of {SMOOTHED_ITERATIONS})", fontsize=9)
    _curves(right, tables.results, "goal_ratio", "", marks=True)
    right.set_title("uniform evaluation", fontsize=9)
    for axes in (left, right):
        axes.set_ylim(RATIO_LIMITS)
        steps_axis(axes, _batch(tables.metrics))
    if tables.results.condition.nunique() > FEW:
        _legend_below(figure)
    else:
        right.legend(title=INTERVALS, fontsize=8, title_fontsize=8, loc="lower right")
    return figure


def _batch(table: pd.DataFrame) -> float:
    return table.env_steps.iloc[0] / table.iteration.iloc[0]


def _side_by_side(table: pd.DataFrame, labels: dict[str, str]) -> Figure:
    figure = Figure((11.4, 4.0), layout="constrained")
    for axes, (column, label) in zip(figure.subplots(1, len(labels)), labels.items(), strict=True):
        _curves(axes, table, column, label, marks=True)
    _legend_below(figure)
    return figure


def _legend_below(figure: Figure, title: str = INTERVALS) -> None:
    """A legend that takes its room from below the axes; the figure grows by it."""
    lines = figure.axes[0].get_legend_handles_labels()
    columns = int(figure.get_figwidth() // 2.2)
    figure.set_figheight(figure.get_figheight() + 0.17 * max(0, math.ceil(len(lines[0]) / columns) - 1))
    place = {"loc": "outside lower center", "ncols": columns}
    figure.legend(*lines, title=title, fontsize=8, title_fontsize=8, **place)


def evaluation(results: pd.DataFrame) -> Figure:
    """What the uniform evaluations found: goal ratio, worst tenth and return (Fig. 7)."""
    labels = {
        "goal_ratio": "goal ratio",
        "cvar": "goal ratio of the worst tenth (CVaR)",
        "mean_return": "mean return",
    }
    figure = _side_by_side(results, labels)
    for axes in figure.axes[:2]:
        axes.set_ylim(RATIO_LIMITS)
    return figure


def groups(results: pd.DataFrame, columns: Sequence[str]) -> Figure:
    """Goal ratio of each group of the uniform evaluations' configurations."""
    rows = math.ceil(len(columns) / 3)
    of_row = math.ceil(len(columns) / rows)
    figure = Figure((3.8 * of_row, 3.6 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, of_row, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, column in zip(panels, columns, strict=False):
        _curves(axes, results, column, "goal ratio", marks=True)
        axes.set_title(column.partition(".")[2], fontsize=9)
        axes.set_ylim(RATIO_LIMITS)
        axes.label_outer()
        steps_axis(axes, _batch(results))
    for axes in panels[len(columns) :]:
        axes.remove()
    _legend_below(figure)
    return figure


def spread(table: pd.DataFrame) -> Figure:
    """Mean and standard deviation over configurations of both ratios (Fig. 6, 10, 12)."""
    keys = ["condition", "seed", "iteration"]
    by_run = trial_and_failure_ratios(table, keys).groupby(keys, sort=False)
    figures = by_run.agg(
        trial_std=("trial", lambda x: x.std(ddof=0)),
        failure_mean=("failure", "mean"),
        failure_std=("failure", lambda x: x.std(ddof=0)),
    ).reset_index()
    labels = {
        "trial_std": "trial ratio: standard deviation",
        "failure_mean": "failure ratio: mean",
        "failure_std": "failure ratio: standard deviation",
    }
    figure = _side_by_side(figures, labels)
    for axes in figure.axes:
        axes.set_ylim(0, None)
    size = table.config.max() + 1
    figure.axes[0].set_title(f"over configurations, since the beginning (mean 1/{size})", fontsize=9)
    return figure


def _missing(rows: pd.DataFrame) -> str:
    number = [np.isfinite(rows[f"exit_at_{at:g}"]).sum() for at in THRESHOLDS]
    return "" if min(number) == len(rows) else f" ({number[0]} and {number[1]} of {len(rows)} runs)"


def exits(metrics: pd.DataFrame, runs: pd.DataFrame) -> Figure:
    """Training goal ratio, and where the paper's exit condition would have ended each run (Fig. 14)."""
    many = runs.condition.nunique() > FEW
    figure = Figure((9.6 if many else 6.8, 4.0), layout="constrained")
    axes = figure.subplots()
    _curves(axes, _smooth(metrics), "goal_ratio", f"training goal ratio (mean of {SMOOTHED_ITERATIONS})")
    batch = _batch(metrics)
    for place, (condition, rows, (color, _, mark)) in enumerate(_conditions(runs)):
        for at in THRESHOLDS:
            exit_at = rows[f"exit_at_{at:g}"].to_numpy() / batch
            height = np.full(len(rows), at + 0.008 * (place - (runs.condition.nunique() - 1) / 2))
            is_named = at == THRESHOLDS[0] and not many  # of many, the colours of their curves say it
            label = f"{condition}: exit{_missing(rows)}" if is_named else None
            style = {"marker": mark, "facecolor": "white", "edgecolor": color, "label": label}
            axes.scatter(exit_at, height, s=22, zorder=3, **style)
    for at in THRESHOLDS:
        axes.axhline(at, color="0.6", linewidth=0.7, linestyle=":")
    axes.set_ylim(0, 1.04)
    steps_axis(axes, batch)
    held = "exit: five iterations in a row held 0.90 or 0.95"
    title = f"{INTERVALS};\n{held}"
    if many:
        _legend_below(figure, title)
    else:
        axes.legend(title=title, fontsize=8, title_fontsize=8)
    return figure
