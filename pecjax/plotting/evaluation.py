"""The report of an evaluation as a figure: success by group, and by what the configurations hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pecjax.plotting.style import (
    BLACK,
    COLUMN,
    PAGE,
    PATH,
    RATIO_LIMITS,
    legend_below,
    name_panels,
    set_title,
    styled,
)
from pecjax.training.eval_report import Report

_COLUMNS = 3  # of panels
_SLANTED = 3  # groups whose names have no room side by side


@styled
def evaluation(report: Report) -> Figure:
    """A panel of the groups, and one of each feature, with the 95 % intervals of the goal ratios."""
    parts: dict[str, list[Report]] = {}
    groups = {name: part for name, part in report["groups"].items() if part["episodes"]}
    if groups:
        parts["Groups"] = [*groups.values()]
    parts |= report["features"]
    parts = parts or {"All configurations": [report["all"]]}
    rows = -(-len(parts) // _COLUMNS)
    columns = -(-len(parts) // rows)
    figure = Figure((COLUMN if columns == 1 else PAGE, 2.1 * rows + 0.3), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel().tolist()
    for axes, (name, of_panel) in zip(panels, parts.items(), strict=False):
        if name in report["features"]:
            _points(axes, [(part["low"] + part["high"]) / 2 for part in of_panel], of_panel)
            for part in of_panel:
                axes.plot([part["low"], part["high"]], [part["goal_ratio"]] * 2, color=PATH, linewidth=0.8)
            axes.set_xlabel((name[:1].upper() + name[1:]).replace("_", " "))
        else:
            _points(axes, range(len(of_panel)), of_panel)
            names = [*groups] if groups else ["all"]
            axes.set_xticks(range(len(names)), names, rotation=30 * (len(names) > _SLANTED))
            axes.set(xlim=(-0.5, len(names) - 0.5), xlabel=name)
        axes.set_ylim(RATIO_LIMITS)
        axes.grid(True)
    for axes in panels[len(parts) :]:
        axes.remove()
    for axes in panels[: len(parts) : columns]:
        axes.set_ylabel("Goal ratio")
    name_panels(panels[: len(parts)], [_episodes(of_panel) for of_panel in parts.values()])
    legend_below(figure)
    whole = report["all"]
    set_title(figure, f"Goal ratio {whole['goal_ratio']:.3f} of {whole['episodes']:,} episodes")
    return figure


def _episodes(parts: list[Report]) -> str:
    """How many episodes a point of a panel is of."""
    number = sorted(part["episodes"] for part in parts)
    return f"n = {number[0]:,}" if number[0] == number[-1] else f"n = {number[0]:,} to {number[-1]:,}"


def _points(axes: Axes, places: Sequence[float], parts: list[Report]) -> None:
    ratios = np.array([part["goal_ratio"] for part in parts])
    low, high = np.array([part["interval"] for part in parts]).T
    errors = np.clip([ratios - low, high - ratios], 0, None)
    label = "Goal ratio of n episodes, 95 % interval (Wilson); horizontal line: range of the value"
    axes.errorbar(places, ratios, errors, fmt="o", color=BLACK, ecolor=PATH, elinewidth=0.8, label=label)
