"""How the runs of a study ended: steps to the thresholds, success by pair, and by α."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pecjax.envs.rooms.settings import Rooms
from pecjax.plotting.seeds import band_of, how_it_spreads, seeds_in_words
from pecjax.plotting.style import (
    BLACK,
    PAGE,
    RATIO_LIMITS,
    SMALL,
    drop_inner_labels,
    legend_below,
    name_panels,
    steps_unit,
    style_of,
    styled,
)
from pecjax.plotting.success_map import success
from pecjax.studies.measures import THRESHOLDS
from pecjax.studies.tables import StudyTables

FEW = 4  # conditions whose names have a place below an axis, side by side
MAPS_IN_ROW = 3
MOST_TICKS = 8  # of an axis of α


@styled
def steps_to_threshold(runs: pd.DataFrame) -> Figure:
    """Steps until five evaluations in a row hold a threshold, a line for each seed.

    Runs that never held it have no number: they lie in a shaded zone above the end of the axis, and
    a bar is drawn only where the median is a number.
    """
    names = list(dict.fromkeys(runs.condition))
    many = len(names) > FEW
    figure = Figure((PAGE, 3.2 if many else 2.6), layout="constrained")
    steps = runs[[f"steps_to_{at:g}" for at in THRESHOLDS]].to_numpy()
    finite = steps[np.isfinite(steps)]
    unit, of_unit = steps_unit(finite.max(initial=0))
    zone = _Zone.above(finite / unit) if np.isinf(steps).any() else None
    top = 1.08 * finite.max() / unit if zone is None else zone.high
    for axes, at in zip(figure.subplots(1, 2, sharey=True), THRESHOLDS, strict=True):
        table = runs.pivot(index="seed", columns="condition", values=f"steps_to_{at:g}")[names] / unit
        shown = table if zone is None else table.replace(np.inf, zone.middle)
        for _, row in shown.iterrows():
            axes.plot(range(len(names)), row, color="0.75", linewidth=0.7, zorder=1)
        for place, name in enumerate(names):
            _condition(axes, place, np.asarray(table[name].dropna()), zone, "/" if many else " of ")
        labels = names if many else [name.replace(", ", "\n") for name in names]
        axes.set_xticks(range(len(names)), labels, rotation=90 if many else 0)
        axes.set(xlim=(-0.5, len(names) - 0.5), ylim=(0, top))
        axes.grid(True, axis="y")
        if zone is not None:
            zone.draw(axes)
    name_panels(figure.axes, [f"Goal ratio {at:g} held by five evaluations" for at in THRESHOLDS])
    figure.axes[0].set_ylabel(f"Environment steps{of_unit}")
    entries: list[Artist] = [
        Line2D([], [], linestyle="", marker="o", color="0.4", label="A run"),
        Line2D([], [], color="0.75", linewidth=0.7, label="Runs of one seed"),
        Line2D([], [], color=BLACK, linewidth=1.6, label="Median of the runs"),
    ]
    legend_below(figure, entries)
    return figure


def _condition(axes: Axes, place: int, steps: np.ndarray, zone: _Zone | None, of: str) -> None:
    """The marks of one condition's runs, how many never held it, and the median if that is a number."""
    look = style_of(place)
    never, shown = int(np.isinf(steps).sum()), steps
    if zone is not None and never:
        shown = np.where(np.isinf(steps), zone.middle, steps)
        style = {"textcoords": "offset points", "xytext": (0, 4), "ha": "center", "fontsize": SMALL}
        axes.annotate(f"{never}{of}{len(steps)}", (place, zone.middle), **style)
    mark = {"color": look["color"], "marker": look["marker"]}
    axes.scatter(np.full(len(shown), place), shown, s=16, zorder=2, **mark)
    median = np.median(steps)
    if np.isfinite(median):
        axes.plot([place - 0.22, place + 0.22], [median, median], color=BLACK, linewidth=1.6, zorder=3)


class _Zone(NamedTuple):
    """Where runs lie that have no number: above the end of the axis of numbers.

    Attributes:
        low, high: its edges on that axis; `low` is 0 where no run has a number.
    """

    low: float
    high: float

    @classmethod
    def above(cls, numbers: np.ndarray) -> _Zone:
        return cls(1.05 * numbers.max(), 1.4 * numbers.max()) if len(numbers) else cls(0, 1)

    @property
    def middle(self) -> float:
        return (self.low + self.high) / 2

    def draw(self, axes: Axes) -> None:
        """Ends the axis of numbers below the zone, and shades it."""
        axes.axhspan(self.low, self.high, color="0.93", linewidth=0, zorder=0)
        ticks = [tick for tick in axes.get_yticks() if self.low and tick <= self.low]
        axes.set_yticks([*ticks, self.middle], [*(f"{tick:g}" for tick in ticks), "Not\nreached"])
        axes.spines[["left", "right"]].set_bounds(0, self.low)
        axes.spines["top"].set_visible(False)


@styled
def maps(tables: StudyTables, task: Rooms) -> Figure:
    """The first map with the last evaluation's goal ratio of every pair, a panel for each condition.

    The colours begin at a round number below the lowest of all ratios.
    """
    table, scene = task.configurations(), task.scene(0)
    counts = tables.configurations
    last = counts.loc[counts.iteration == counts.iteration.max()]
    by_name = last.groupby(["condition", "config"], sort=False).goal_ratio.mean()
    ratios = {name: by_name[name].sort_index().to_numpy() for name in dict.fromkeys(last.condition)}
    low = min(0.9, math.floor(10 * np.nanmin(by_name)) / 10)
    rows = math.ceil(len(ratios) / MAPS_IN_ROW)
    columns = max(2, math.ceil(len(ratios) / rows))
    (left, bottom), (right, top) = scene.map.bounds
    height = (PAGE - 1.3) / columns * (top - bottom) / (right - left)
    figure = Figure((PAGE, rows * (height + 0.3) + 0.6), layout="compressed")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel().tolist()
    for axes in panels[len(ratios) :]:
        axes.remove()
    panels = panels[: len(ratios)]
    shades = [
        success(axes, scene, table, of_one, task, low)
        for axes, of_one in zip(panels, ratios.values(), strict=True)
    ]
    drop_inner_labels(panels, columns)
    name_panels(panels, [f"{name}, mean {np.nanmean(of_one):.3f}" for name, of_one in ratios.items()])
    label = f"Goal ratio, mean of {seeds_in_words(last)}"
    figure.colorbar(shades[0], ax=panels, label=label, shrink=0.8, aspect=30)
    return figure


@styled
def alphas(runs: pd.DataFrame) -> Figure:
    """How the end of training depends on α (Fig. 11-12): failures since the beginning, evaluation.

    The runs stand beside what is made of them, as small points.
    """
    figure = Figure((PAGE, 2.7), layout="constrained")
    panels = figure.subplots(1, 2)
    failure, goals = (
        {"failure_ratio": "mean over configurations"},
        {"goal_ratio": "all configurations", "cvar": "worst tenth"},
    )
    known = runs.dropna(subset="alpha")
    values, place = sorted(set(known.alpha)), 0
    for axes, lines in zip(panels, (failure, goals), strict=True):
        for sampler, rows in known.groupby("sampler", sort=False):
            for column, words in lines.items():
                look = style_of(place) | {"label": f"{sampler}: {words}"}
                beside = 0.02 * np.ptp(values) * (1 + place % 2)
                _by_alpha(axes, known, rows, column, look, beside)
                place += 1
        if len(values) <= MOST_TICKS:
            axes.set_xticks(values)
        axes.set_xlabel("α")
        axes.grid(True)
    panels[0].set(ylabel="Failure ratio", ylim=(0, min(1.02, max(0.1, 1.1 * runs.failure_ratio.max()))))
    panels[1].set(ylabel="Goal ratio", ylim=RATIO_LIMITS)
    name_panels(panels, ["Training, since its beginning", "Last uniform evaluation"])
    panels[0].plot([], [], ".", color="0.4", label="A run, beside its α")
    legend_below(figure, title=how_it_spreads(known))
    return figure


def _by_alpha(
    axes: Axes, drawn: pd.DataFrame, rows: pd.DataFrame, column: str, look: dict[str, Any], beside: float
) -> None:
    """A line with bars over the seeds, and the runs as points that far to the right of their α.

    Args:
        drawn: all rows of the figure, which say what bars are; `rows` are those of the line.
    """
    found = {alpha: band_of(drawn, x.to_numpy()) for alpha, x in rows.groupby("alpha")[column]}
    value, low, high = np.array(list(found.values())).T
    error = np.clip(np.nan_to_num([value - low, high - value]), 0, None)
    axes.errorbar(np.array(list(found), float), value, error, **look)
    axes.scatter(rows.alpha + beside, rows[column], s=4, color=look["color"], alpha=0.6, linewidth=0)
