"""How the runs of a study ended: steps to the thresholds, success by pair, and by α."""

from __future__ import annotations

from itertools import count
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pecjax.envs.rooms.settings import Rooms
from pecjax.plotting.maps import success
from pecjax.plotting.study_curves import FEW, INTERVALS, style_of
from pecjax.plotting.style import RATIO_LIMITS, steps_unit
from pecjax.studies.report import THRESHOLDS
from pecjax.studies.statistics import Interval, interval
from pecjax.studies.tables import StudyTables


def steps_to_threshold(runs: pd.DataFrame) -> Figure:
    """Steps until five evaluations in a row hold a threshold, a line for each seed.

    Runs that never held it have no number: they lie in a shaded zone above the end of the axis, and
    a bar is drawn only where the median is a number.
    """
    names = list(dict.fromkeys(runs.condition))
    many = len(names) > FEW
    figure = Figure((max(8.4, 0.9 * len(names)), 4.8 if many else 4.0), layout="constrained")
    steps = runs[[f"steps_to_{at:g}" for at in THRESHOLDS]].to_numpy()
    finite = steps[np.isfinite(steps)]
    unit, of_unit = steps_unit(finite.max(initial=0))
    zone = _Zone.above(finite / unit) if np.isinf(steps).any() else None
    top = 1.08 * finite.max() / unit if zone is None else zone.high
    for axes, at in zip(figure.subplots(1, 2, sharey=True), THRESHOLDS, strict=True):
        table = runs.pivot(index="seed", columns="condition", values=f"steps_to_{at:g}")[names] / unit
        shown = table if zone is None else table.replace(np.inf, zone.middle)
        for _, row in shown.iterrows():
            axes.plot(range(len(names)), row, color="0.7", linewidth=0.8, zorder=1)
        for place, name in enumerate(names):
            _condition(axes, place, np.asarray(table[name].dropna()), zone)
        labels = names if many else [name.replace(", ", "\n") for name in names]
        axes.set_xticks(range(len(names)), labels, fontsize=8, rotation=90 if many else 0)
        axes.set(xlim=(-0.5, len(names) - 0.5), ylim=(0, top))
        axes.set_title(f"goal ratio {at:g} held by five uniform evaluations", fontsize=9)
        axes.grid(alpha=0.3, axis="y")
        if zone is not None:
            zone.draw(axes)
    if len(finite):
        figure.axes[0].set_ylabel(f"environment steps{of_unit}; bar: median")
    return figure


def _condition(axes: Axes, place: int, steps: np.ndarray, zone: _Zone | None) -> None:
    """The marks of one condition's runs, and its median if that is a number."""
    color, _, mark = style_of(place)
    never, shown = int(np.isinf(steps).sum()), steps
    if zone is not None and never:
        shown = np.where(np.isinf(steps), zone.middle, steps)
        style = {"textcoords": "offset points", "xytext": (0, 5), "ha": "center", "fontsize": 8}
        axes.annotate(f"{never} of {len(steps)}", (place, zone.middle), **style)
    axes.scatter(np.full(len(shown), place), shown, color=color, marker=mark, s=24, zorder=2)
    median = np.median(steps)
    if np.isfinite(median):
        axes.plot([place - 0.22, place + 0.22], [median, median], color="black", linewidth=1.6, zorder=3)


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
        axes.annotate(
            "not reached",
            (0, self.high),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            xytext=(4, -4),
            fontsize=8,
            va="top",
        )
        axes.set_yticks([tick for tick in axes.get_yticks() if self.low and tick <= self.low])
        axes.spines[["left", "right"]].set_bounds(0, self.low)
        axes.spines["top"].set_visible(False)


def maps(tables: StudyTables, task: Rooms) -> Figure:
    """The first map with the last evaluation's goal ratio of every pair, a panel for each condition."""
    table, scene = task.configurations(), task.scene(0)
    last = tables.configurations[tables.configurations.iteration == tables.configurations.iteration.max()]
    by_condition = list(last.groupby("condition", sort=False))
    figure = Figure((4.6 * len(by_condition) + 0.8, 5.0), layout="constrained")
    panels = figure.subplots(1, len(by_condition), sharey=True, squeeze=False)[0]
    shades = []
    for axes, (condition, counts) in zip(panels, by_condition, strict=True):
        ratios = counts.groupby("config").goal_ratio.mean().to_numpy()
        shades.append(success(axes, scene, table, ratios, task))
        axes.set_title(f"{condition}: {np.nanmean(ratios):.3f} of all reach the goal", fontsize=9)
        axes.label_outer()
    figure.colorbar(shades[0], ax=list(panels), label="goal ratio, mean over seeds", shrink=0.7, extend="min")
    return figure


def alphas(runs: pd.DataFrame) -> Figure:
    """How the end of training depends on α (Fig. 11-12): failures since the beginning, evaluation."""
    figure = Figure((9.6, 4.2), layout="constrained")
    panels = {
        "failure ratio since the beginning": {"failure_ratio": "mean over configurations"},
        "goal ratio, last uniform evaluation": {
            "goal_ratio": "all configurations",
            "cvar": "worst tenth (CVaR)",
        },
    }
    of_samplers = list(runs.dropna(subset="alpha").groupby("sampler", sort=False))
    for axes, (label, lines) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        curves = [(sampler, rows, name) for sampler, rows in of_samplers for name in lines]
        for (sampler, rows, name), (color, dashes, mark) in zip(curves, map(style_of, count()), strict=False):
            found = {alpha: interval(x.to_numpy()) for alpha, x in rows.groupby("alpha")[name]}
            of = f"{sampler}, " if len(of_samplers) > 1 else ""
            _error_bars(axes, found, color=color, linestyle=dashes, marker=mark, label=of + lines[name])
        axes.set(xlabel="α", ylabel=label)
        axes.grid(alpha=0.3)
        place = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16), "ncols": 2}
        axes.legend(title=INTERVALS, fontsize=8, title_fontsize=8, **place)
    failures, goals = figure.axes
    failures.set_ylim(0, min(1.02, max(0.1, failures.get_ylim()[1])))
    goals.set_ylim(RATIO_LIMITS)
    return figure


def _error_bars(axes: Axes, found: dict[Any, Interval], **style: Any) -> None:
    value, low, high = np.array(list(found.values())).T
    error = np.nan_to_num([value - low, high - value])
    axes.errorbar(list(found), value, error, capsize=3, markersize=4, **style)
