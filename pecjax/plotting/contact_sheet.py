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
from pecjax.plotting.style import GOAL, PAGE, PATH, SMALL, legend_below, styled

_CELL = (1.4, 2.2)  # inches: less has no room for its title
_WALL: dict[str, Any] = {"facecolor": "0.25", "linewidth": 0, "zorder": 2}
_IN_THE_WAY: dict[str, Any] = {"facecolor": "0.55", "edgecolor": "0.25", "linewidth": 0.4, "zorder": 1.8}
_PASSED: dict[str, Any] = {"facecolor": "0.92", "edgecolor": "0.75", "linewidth": 0.4, "zorder": 1}


@styled
def contact_sheet(plans: Plans, per_family: int = 4) -> Figure:
    """The first few plans of each family, a row a family, all to one scale.

    Args:
        per_family: how many of each.
    """
    rows = [np.flatnonzero(plans.family == family)[:per_family] for family in range(len(plans.names))]
    shown = [(plans.names[family], chosen) for family, chosen in enumerate(rows) if len(chosen)]
    columns = max(len(chosen) for _, chosen in shown)
    cell = float(np.clip((PAGE - 0.3) / columns, *_CELL))
    figure = Figure((cell * columns + 0.3, (cell + 0.15) * len(shown)), layout="constrained")
    cells = figure.subplots(len(shown), columns, squeeze=False)
    extent = (plans.bounds[:, 1] - plans.bounds[:, 0])[np.concatenate(rows)].max()
    for line, (name, chosen) in zip(cells, shown, strict=True):
        for axes in line:
            axes.set_axis_off()
        upright = {"rotation": 90, "ha": "right", "va": "center", "transform": line[0].transAxes}
        line[0].text(-0.03, 0.5, name.capitalize(), **upright)
        for axes, number in zip(line, chosen, strict=False):
            _plan(axes, plans, int(number), float(extent))
    legend_below(figure, _legend())
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
    axes.plot(*start, "o", color=GOAL, markersize=3, zorder=4)
    axes.plot(
        *goal,
        "o",
        markerfacecolor="white",
        markeredgecolor=GOAL,
        markeredgewidth=1,
        markersize=4,
        zorder=4,
    )
    middle, half = plans.bounds[number].mean(axis=0), extent / 2
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set_aspect("equal")
    doors = int(plans.doors[number])
    through = f", {doors} door{'s' * (doors > 1)}" * (doors > 0)
    words = f"{number}: {plans.geodesic[number]:.1f} m{through}"
    axes.set_title(words, loc="center", fontsize=SMALL, pad=2)


def _legend() -> list[Any]:
    dot: dict[str, Any] = {"linestyle": "", "marker": "o", "color": GOAL}
    return [
        Line2D([], [], markersize=3, label="Start", **dot),
        Line2D([], [], markersize=4, markerfacecolor="white", markeredgewidth=1, label="Goal", **dot),
        Line2D([], [], color=PATH, linewidth=1.2, label="Shortest path"),
        Patch(**_WALL, label="Wall"),
        Patch(**_IN_THE_WAY, label="In the way of flights"),
        Patch(**_PASSED, label="Flown over or under"),
    ]
