"""Curves of a study: its figures against iteration, with intervals over seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pecjax.plotting.seeds import band_of, by_condition, how_it_spreads
from pecjax.plotting.style import (
    PAGE,
    RATIO_LIMITS,
    by_iteration,
    drop_inner_labels,
    legend_below,
    name_panels,
    smoothed,
    steps_axis,
    style_of,
    styled,
    window,
)
from pecjax.studies.measures import THRESHOLDS
from pecjax.studies.statistics import effective_number, trial_and_failure_ratios
from pecjax.studies.tables import StudyTables

FEW = 3  # conditions whose bands can be told apart; of more, bars are drawn instead
BARS = 5  # of a line whose interval is shown by bars


def _curves(axes: Axes, table: pd.DataFrame, column: str, label: str, marks: bool = False) -> None:
    """A line for each condition, and its interval over seeds.

    The interval is a band where the conditions are few. Of more, bands would merge: there it is shown by
    bars, each line's at other places.
    """
    found = {
        condition: rows.pivot(index="iteration", columns="seed", values=column).dropna()
        for condition, rows in by_condition(table)
    }
    for place, (condition, runs) in enumerate(found.items()):
        if runs.empty:
            continue
        value, low, high = np.array([band_of(table, of_seeds) for of_seeds in runs.to_numpy()]).T
        style = style_of(place)
        style["marker"] *= marks
        axes.plot(runs.index, value, label=condition, **style)
        if len(found) <= FEW:
            band = {"color": style["color"], "alpha": 0.2, "linewidth": 0}
            axes.fill_between(runs.index, low, high, **band)
        elif np.isfinite(low).all():
            every = min(max(len(runs) // BARS, len(found)), len(runs))
            first = every * place // len(found)
            bars = {"fmt": "none", "ecolor": style["color"], "elinewidth": 0.8, "zorder": 1.9}
            errors = np.clip([value - low, high - value], 0, None)
            axes.errorbar(runs.index, value, errors, errorevery=(first, every), **bars)
    axes.set(ylabel=label, xlim=(0, 1.03 * table.iteration.max()))
    by_iteration(axes)


def _smooth(metrics: pd.DataFrame) -> pd.DataFrame:
    """The training goal ratio of each run, each the mean of the iterations around it.

    At most about 100 iterations are left, with the last: more points would be drawn on one another.
    """
    ratios = metrics.groupby(["condition", "seed"], sort=False).goal_ratio
    mean = ratios.transform(smoothed)
    last = metrics.iteration.max()
    shown = (last - metrics.iteration) % math.ceil(last / 100) == 0
    return metrics.assign(goal_ratio=mean).loc[shown]


@styled
def goal_ratio(tables: StudyTables) -> Figure:
    """Goal ratio against iteration, in training and on the uniform evaluation (Fig. 4, 8)."""
    figure = Figure((PAGE, 2.7), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _curves(left, _smooth(tables.metrics), "goal_ratio", "Goal ratio")
    _curves(right, tables.results, "goal_ratio", "", marks=True)
    name_panels([left, right], [f"Training, {_of_iterations(tables.metrics)}", "Uniform evaluation"])
    for axes in (left, right):
        axes.set_ylim(RATIO_LIMITS)
        steps_axis(axes, _batch(tables.metrics))
    legend_below(figure, _entries(tables.results), how_it_spreads(tables.results))
    return figure


def _of_iterations(metrics: pd.DataFrame) -> str:
    return f"centred mean of {window(metrics.iteration.max())} iterations"


def _batch(table: pd.DataFrame) -> float:
    return table.env_steps.iloc[0] / table.iteration.iloc[0]


def _entries(table: pd.DataFrame) -> list[Artist]:
    """A line of a legend for each condition, with dashes and mark."""
    names = [str(condition) for condition, _ in by_condition(table)]
    return [Line2D([], [], label=name, **style_of(place)) for place, name in enumerate(names)]


def _side_by_side(table: pd.DataFrame, panels: dict[str, tuple[str, str]]) -> Figure:
    """A panel for each column.

    Args:
        panels: the title and the label of each, by column.
    """
    figure = Figure((PAGE, 2.5), layout="constrained")
    all_axes = figure.subplots(1, len(panels))
    for axes, (column, (_, label)) in zip(all_axes, panels.items(), strict=True):
        _curves(axes, table, column, label, marks=True)
    name_panels(all_axes, [title for title, _ in panels.values()])
    return figure


@styled
def evaluation(results: pd.DataFrame) -> Figure:
    """What the uniform evaluations found: goal ratio, worst tenth and return (Fig. 7)."""
    panels = {
        "goal_ratio": ("Success", "Goal ratio"),
        "cvar": ("Success, worst tenth (CVaR)", "Goal ratio"),
        "mean_return": ("Return", "Mean return (reward)"),
    }
    figure = _side_by_side(results, panels)
    for axes in figure.axes[:2]:
        axes.set_ylim(RATIO_LIMITS)
    legend_below(figure, _entries(results), how_it_spreads(results))
    return figure


@styled
def groups(results: pd.DataFrame, columns: Sequence[str]) -> Figure:
    """Goal ratio of each group of the uniform evaluations' configurations."""
    rows = math.ceil(len(columns) / 3)
    of_row = math.ceil(len(columns) / rows)
    figure = Figure((PAGE, 2.2 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, of_row, sharex=True, sharey=True, squeeze=False).ravel().tolist()
    for axes, column in zip(panels, columns, strict=False):
        _curves(axes, results, column, "Goal ratio", marks=True)
        axes.set_ylim(RATIO_LIMITS)
    for axes in panels[len(columns) :]:
        axes.remove()
    drop_inner_labels(panels[: len(columns)], of_row)
    name_panels(panels[: len(columns)], [column.partition(".")[2] for column in columns])
    legend_below(figure, _entries(results), how_it_spreads(results))
    return figure


@styled
def spread(table: pd.DataFrame) -> Figure:
    """How many configurations were drawn, and how unlike their failure ratios are (Fig. 6, 10, 12)."""
    keys = ["condition", "seed", "iteration"]
    by_run = trial_and_failure_ratios(table, keys).groupby(keys, sort=False)
    figures = by_run.agg(
        effective=("trial", effective_number),
        mean=("failure", "mean"),
        deviation=("failure", lambda x: x.std(ddof=0)),
    ).reset_index()
    panels = {
        "effective": ("Trials, exp(entropy)", "Effective number"),
        "mean": ("Failures, mean", "Failure ratio"),
        "deviation": ("Failures, standard deviation", "Failure ratio"),
    }
    figure = _side_by_side(figures, panels)
    size = table.config.nunique()
    all_alike = {"color": "black", "linewidth": 0.7, "linestyle": ":", "label": f"All {size:,} alike"}
    figure.axes[0].axhline(size, **all_alike)
    for axes, top in zip(figure.axes, (1.08 * size, None, None), strict=True):
        axes.set_ylim(0, top)
    legend_below(figure, [*_entries(figures), Line2D([], [], **all_alike)], how_it_spreads(figures))
    return figure


def _exits(name: str, rows: pd.DataFrame) -> str:
    """A condition with how many of its runs exited at each threshold, where that is not all of them."""
    number = [int(np.isfinite(rows[f"exit_at_{at:g}"]).sum()) for at in THRESHOLDS]
    of_all = "" if min(number) == len(rows) else f": exit in {number[0]} and {number[1]} of {len(rows)} runs"
    return name + of_all


@styled
def exits(metrics: pd.DataFrame, runs: pd.DataFrame) -> Figure:
    """Training goal ratio, and where the paper's exit condition would have ended each run (Fig. 14)."""
    figure = Figure((PAGE, 2.9), layout="constrained")
    axes, batch, entries = figure.subplots(), _batch(metrics), []
    _curves(axes, _smooth(metrics), "goal_ratio", "Training goal ratio")
    for place, (condition, rows) in enumerate(by_condition(runs)):
        style, shift = style_of(place), 0.008 * (place - (runs.condition.nunique() - 1) / 2)
        entries.append(Line2D([], [], label=_exits(str(condition), rows), **style, markerfacecolor="white"))
        for at in THRESHOLDS:
            exit_at = rows[f"exit_at_{at:g}"].to_numpy() / batch
            mark = {"marker": style["marker"], "facecolor": "white", "edgecolor": style["color"]}
            axes.scatter(exit_at, np.full(len(rows), at + shift), s=14, zorder=3, **mark)
    for at in THRESHOLDS:
        axes.axhline(at, color="0.6", linewidth=0.7, linestyle=":")
    axes.set_ylim(0, 1.04)
    steps_axis(axes, batch)
    low, high = THRESHOLDS
    marks = f"Marks: exits, where five iterations in a row held {low:g} or {high:g}"
    lines = f"Lines: {_of_iterations(metrics)}. {how_it_spreads(metrics)}"
    legend_below(figure, entries, f"{lines}\n{marks}")
    return figure
