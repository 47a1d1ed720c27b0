"""The report of an evaluation as a figure: success by group, and by what the configurations hold."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pecjax.plotting.style import GOAL, PATH
from pecjax.training.eval_report import Report

_COLUMNS = 3  # of panels


def evaluation(report: Report) -> Figure:
    """A panel of the groups, and one of each feature, with the 95 % intervals of the goal ratios."""
    panels = (["groups"] if report["groups"] else []) + [*report["features"]]
    rows, columns = -(-max(len(panels), 1) // _COLUMNS), min(max(len(panels), 1), _COLUMNS)
    figure = Figure((3.4 * columns, 2.9 * rows + 0.4), layout="constrained")
    all_axes = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for axes, name in zip(all_axes, panels, strict=False):
        if name == "groups":
            groups = {of: part for of, part in report["groups"].items() if part["episodes"]}
            _points(axes, np.arange(len(groups)), [*groups.values()])
            axes.set_xticks(range(len(groups)), [*groups])
            axes.set_xlim(-0.5, len(groups) - 0.5)
        else:
            bins = report["features"][name]
            _points(axes, np.array([(part["low"] + part["high"]) / 2 for part in bins]), bins)
            for part in bins:
                axes.plot([part["low"], part["high"]], [part["goal_ratio"]] * 2, color=PATH, linewidth=1)
            axes.set_xlabel(name)
        axes.set_ylim(-0.02, 1.02)
        axes.grid(alpha=0.3)
    for axes in all_axes[len(panels) :]:
        axes.remove()
    for row in range(rows):
        all_axes[row * columns].set_ylabel("goal ratio")
    whole = report["all"]
    figure.suptitle(
        f"goal ratio {whole['goal_ratio']:.3f} of {whole['episodes']} episodes; bars: 95 %", fontsize=9
    )
    return figure


def _points(axes: Axes, places: np.ndarray, parts: list[Report]) -> None:
    ratios = np.array([part["goal_ratio"] for part in parts])
    low, high = np.array([part["interval"] for part in parts]).T
    errors = np.clip([ratios - low, high - ratios], 0, None)
    axes.errorbar(places, ratios, errors, fmt="o", color=GOAL, markersize=4, capsize=3)
