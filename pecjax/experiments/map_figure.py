"""The map from above, with configurations and flights (Fig. 2-3)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable, viridis
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle

from pecjax.experiments.drawing import FAILURES, GOAL, PATH
from pecjax.world.coordinates import Configurations
from pecjax.world.scene import Scene


def rooms(scene: Scene, table: Configurations, trajectories: pd.DataFrame | None = None) -> Figure:
    """The map with its configurations and, if any, flown trajectories (Fig. 2-3)."""
    figure = Figure((6.4, 6.4), layout="constrained")
    axes = figure.subplots()
    floor_plan(axes, scene)
    if trajectories is not None:
        for _, path in trajectories.groupby("episode"):
            reached = path.goal.iloc[0] == 1
            color, alpha = (PATH, 0.7) if reached else (FAILURES, 1)
            axes.plot(path.x, path.y, color=color, linewidth=0.9, alpha=alpha)
            if not reached:
                axes.plot(path.x.iloc[-1], path.y.iloc[-1], "x", color=FAILURES)
        flights = trajectories.groupby("episode").goal.first()
        axes.set_title(
            f"{int(flights.sum())} of {len(flights)} flights reach their goal (× where one ends otherwise)",
            fontsize=9,
        )
    for start, goal in zip(np.asarray(table.start), np.asarray(table.goal), strict=True):
        axes.plot(*np.stack([start, goal]).T, color="0.6", linewidth=0.6, linestyle=":", zorder=1)
    _places(axes, table)
    return figure


def success(axes: Axes, scene: Scene, table: Configurations, ratios: np.ndarray) -> ScalarMappable:
    """The map with a line for every configuration, coloured by its goal ratio, the lower the broader.

    A pair and its reverse bend apart, each to the right of its way.

    Returns:
        what a colour bar needs.
    """
    colors = LinearSegmentedColormap.from_list("dark", viridis(np.linspace(0, 0.85, 64)))
    shade = ScalarMappable(Normalize(0.5, 1), colors)
    floor_plan(axes, scene)
    for start, goal, ratio in zip(np.asarray(table.start), np.asarray(table.goal), ratios, strict=True):
        arrow = FancyArrowPatch(
            start,
            goal,
            connectionstyle="arc3,rad=0.12",
            arrowstyle="-|>",
            mutation_scale=8,
            shrinkA=4,
            shrinkB=4,
            linewidth=1.2 + 4 * (1 - ratio),
            color=shade.to_rgba(ratio),
        )
        axes.add_patch(arrow)
    _places(axes, table)
    return shade


def floor_plan(axes: Axes, scene: Scene) -> None:
    """The walls, seen from above, in metres."""
    for lower, upper in zip(scene.wall_lower, scene.wall_upper, strict=True):
        size = upper - lower
        axes.add_patch(Rectangle((lower[0], lower[1]), size[0], size[1], color="0.35", linewidth=0))
    low, high = scene.wall_lower[:, :2].min(axis=0), scene.wall_upper[:, :2].max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)", ylabel="y (m)", aspect="equal")


def _places(axes: Axes, table: Configurations) -> None:
    """Marks every place once and names the configurations that start there."""
    starts: dict[tuple[float, float], list[int]] = {}
    for row, (start, goal) in enumerate(zip(np.asarray(table.start), np.asarray(table.goal), strict=True)):
        starts.setdefault((float(start[0]), float(start[1])), []).append(row)
        starts.setdefault((float(goal[0]), float(goal[1])), [])
    for place, rows in starts.items():
        axes.plot(*place, "o", color=GOAL, markersize=5)
        if rows:
            name = ",".join(f"c{row}" for row in rows)
            axes.annotate(name, place, textcoords="offset points", xytext=(4, 5), fontsize=7, color=GOAL)
