"""Contact sheets: many floor plans on one page, each with its flight."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from pecjax.envs.rooms.geodesics import shortest_ways
from pecjax.envs.rooms.plans.export import kinds_of_boxes
from pecjax.envs.rooms.plans.measures import plan_paths
from pecjax.envs.rooms.plans.plans import FLIGHT_HEIGHT, RADIUS, Plans
from pecjax.plotting.style import GOAL, PATH

_WALL: dict[str, Any] = {"facecolor": "0.25", "linewidth": 0, "zorder": 2}
_IN_THE_WAY: dict[str, Any] = {"facecolor": "0.55", "edgecolor": "0.25", "linewidth": 0.4, "zorder": 1.8}
_PASSED: dict[str, Any] = {"facecolor": "0.92", "edgecolor": "0.75", "linewidth": 0.4, "zorder": 1}


def contact_sheet(plans: Plans, per_family: int = 4) -> Figure:
    """The first few plans of each family, a row a family, all to one scale.

    Args:
        per_family: how many of each.
    """
    rows = [np.flatnonzero(plans.family == family)[:per_family] for family in range(len(plans.names))]
    shown = [(plans.names[family], chosen) for family, chosen in enumerate(rows) if len(chosen)]
    columns = max(len(chosen) for _, chosen in shown)
    figure = Figure((2.2 * columns + 0.4, 2.42 * len(shown) + 0.5), layout="constrained")
    cells = figure.subplots(len(shown), columns, squeeze=False)
    extent = (plans.bounds[:, 1] - plans.bounds[:, 0])[np.concatenate(rows)].max()
    for line, (name, chosen) in zip(cells, shown, strict=True):
        for axes in line:
            axes.set_axis_off()
        line[0].text(
            -0.03, 0.5, name, rotation=90, ha="right", va="center", fontsize=10, transform=line[0].transAxes
        )
        for axes, number in zip(line, chosen, strict=False):
            _plan(axes, plans, int(number), float(extent))
    figure.legend(handles=_legend(), loc="outside lower center", ncols=3, fontsize=8, columnspacing=1.5)
    return figure


def _plan(axes: Axes, plans: Plans, number: int, extent: float) -> None:
    """One plan from above, in the middle of a square of `extent` metres."""
    lower, upper = plans.boxes(number)
    for low, high, kind in zip(lower, upper, kinds_of_boxes(lower, upper), strict=True):
        if kind in ("floor", "ceiling"):
            continue
        hit = low[2] <= FLIGHT_HEIGHT + RADIUS and high[2] >= FLIGHT_HEIGHT - RADIUS
        style = _WALL if kind == "wall" else _IN_THE_WAY if hit else _PASSED
        axes.add_patch(Rectangle((low[0], low[1]), *(high - low)[:2].tolist(), **style))
    start, goal = (np.asarray(ends[number], np.float64) for ends in (plans.start, plans.goal))
    (way,) = shortest_ways(plan_paths(lower, upper, plans.bounds[number]), start[None], goal[None])
    axes.plot(*way.points.T, color=PATH, linewidth=1.2, zorder=3)
    axes.plot(*start, "o", color=GOAL, markersize=4.5, zorder=4)
    axes.plot(
        *goal,
        "o",
        markerfacecolor="white",
        markeredgecolor=GOAL,
        markeredgewidth=1.3,
        markersize=5.5,
        zorder=4,
    )
    middle, half = plans.bounds[number].mean(axis=0), extent / 2
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set_aspect("equal")
    doors = int(plans.doors[number])
    through = f", {doors} door{'s' * (doors > 1)}" * (doors > 0)
    axes.set_title(f"{number}: {plans.geodesic[number]:.1f} m{through}", fontsize=8, pad=2)


def _legend() -> list[Any]:
    dot: dict[str, Any] = {"linestyle": "", "marker": "o", "color": GOAL}
    return [
        Line2D([], [], markersize=4.5, label="start", **dot),
        Line2D([], [], markersize=5.5, markerfacecolor="white", markeredgewidth=1.3, label="goal", **dot),
        Line2D([], [], color=PATH, linewidth=1.2, label="shortest path"),
        Patch(**_WALL, label="wall"),
        Patch(**_IN_THE_WAY, label="in the way of flights"),
        Patch(**_PASSED, label="flown over or under"),
    ]
