"""The map from above, with configurations and flights (Fig. 2-3)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable, viridis
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, Patch, Rectangle

from pecjax.envs.axes import fill
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.scene import Scene
from pecjax.plotting.style import FAILURES, GOAL, PATH

Place = tuple[float, float]  # m

# How walls look: at the flight height, below or above it, and a floor or ceiling.
SOLID: dict[str, Any] = {"facecolor": "0.35", "linewidth": 0, "zorder": 1}
PASSED: dict[str, Any] = {
    "facecolor": "none",
    "edgecolor": "0.65",
    "hatch": "////",
    "linewidth": 0.6,
    "zorder": 0.8,
}
MOST_NAMES = 60  # of configurations; more would hide the map
MOST_WAYS = 200  # beyond which only configurations with a flight are drawn
COVER: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.8", "linewidth": 0.6, "zorder": 0.6}


def rooms(
    scene: Scene,
    table: Configurations,
    trajectories: pd.DataFrame | None = None,
    rules: NavigationSettings = NavigationSettings(),
    map_id: int = 0,
) -> Figure:
    """The map with its configurations and, if any, flown trajectories (Fig. 2-3).

    Args:
        scene: one of the task's maps; configurations in others are left out.
        trajectories: columns episode, config, success, x and y, a row a step.
        rules: of the task.
        map_id: the map's place among the task's.
    """
    figure = Figure((6.4, 6.4), layout="constrained")
    axes = figure.subplots()
    floor_plan(axes, scene, rules)
    if trajectories is not None:
        for _, path in trajectories.groupby("episode"):
            reached = path.success.iloc[0] == 1
            color, alpha = (PATH, 0.7) if reached else (FAILURES, 1)
            axes.plot(path.x, path.y, color=color, linewidth=0.9, alpha=alpha)
            if not reached:
                axes.plot(path.x.iloc[-1], path.y.iloc[-1], "x", color=FAILURES)
        flights = trajectories.groupby("episode").success.first()
        axes.set_title(
            f"{int(flights.sum())} of {len(flights)} flights reach their goal (× where one ends otherwise)",
            fontsize=9,
        )
    ways = _ways(table, map_id)
    if trajectories is not None and len(ways) > MOST_WAYS:
        ways = {row: ways[row] for row in sorted(set(trajectories.config)) if row in ways}
    for start, goal in ways.values():
        way = {"linestyle": ":", "linewidth": 0.6, "color": "0.6", "shrinkA": 0, "shrinkB": 3}
        axes.add_patch(FancyArrowPatch(start, goal, arrowstyle="-|>", mutation_scale=7, zorder=1, **way))
    _places(axes, ways, rules)
    entries = _legend(axes, trajectories, rules)
    figure.legend(handles=entries, loc="outside lower center", ncols=3, fontsize=8, columnspacing=1)
    return figure


def _legend(axes: Axes, trajectories: pd.DataFrame | None, rules: NavigationSettings) -> list[Artist]:
    """An entry for each kind of thing that the map shows."""
    radius = rules.goal_radius
    ring = {"marker": "o", "markersize": 9, "markerfacecolor": "none", "linestyle": ""}
    entries: list[Artist] = [
        Line2D([], [], color=GOAL, marker="o", markersize=5, linestyle="", label="start"),
        Line2D([], [], color=GOAL, **ring, label=f"goal, reached within {radius:g} m"),
        Line2D([], [], color="0.6", linestyle=":", label="from start to goal"),
    ]
    if trajectories is not None:
        if (trajectories.success == 1).any():
            entries.append(Line2D([], [], color=PATH, label="flight that reached its goal"))
        if (trajectories.success != 1).any():
            entries.append(Line2D([], [], color=FAILURES, marker="x", label="flight that ended otherwise"))
    if any(patch.get_hatch() for patch in axes.patches):
        entries.append(Patch(**PASSED, label="wall below or above flights"))
    return entries


def success(
    axes: Axes, scene: Scene, table: Configurations, ratios: np.ndarray, rules: NavigationSettings
) -> ScalarMappable:
    """The map with a line for every configuration, coloured by its goal ratio, the lower the broader.

    A pair and its reverse bend apart, each to the right of its way.

    Args:
        scene: the first of the task's maps.
        ratios: (N,), of all configurations.

    Returns:
        what a colour bar needs.
    """
    colors = LinearSegmentedColormap.from_list("dark", viridis(np.linspace(0, 0.85, 64)))
    shade = ScalarMappable(Normalize(0.5, 1), colors)
    floor_plan(axes, scene, rules)
    ways = _ways(table)
    for row, (start, goal) in ways.items():
        ratio = ratios[row]
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
    _places(axes, ways, rules)
    return shade


def floor_plan(axes: Axes, scene: Scene, rules: NavigationSettings = NavigationSettings()) -> None:
    """The walls from above, in metres: solid what the drone can hit at its flight height.

    Walls that it flies over or under are hatched; a floor or a ceiling is outlined only.
    """
    limits = scene.map.bounds
    for lower, upper in zip(scene.wall_lower, scene.wall_upper, strict=True):
        (x, y), (right, top) = np.clip([lower[:2], upper[:2]], *limits)
        style = _wall_style(scene, rules.flight_height, lower, upper)
        axes.add_patch(Rectangle((x, y), right - x, top - y, **style))
    (left, bottom), (right, top) = limits
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x (m)", ylabel="y (m)", aspect="equal")


def _wall_style(scene: Scene, height: float, lower: np.ndarray, upper: np.ndarray) -> dict[str, Any]:
    limits, radius = scene.map.bounds, scene.drone_radius
    if lower[2] - radius <= height <= upper[2] + radius:
        return SOLID
    (low, high), inside = limits, np.clip([lower[:2], upper[:2]], *limits)
    covered = np.prod(inside[1] - inside[0]) / np.prod(high - low)
    return COVER if covered > 0.5 else PASSED


def _ways(table: Configurations, map_id: int = 0) -> dict[int, tuple[Place, Place]]:
    """Start and goal of each configuration in one map, by its number."""
    rows = np.flatnonzero(np.asarray(fill(table).map_id) == map_id)
    starts, goals = (np.asarray(part)[rows].tolist() for part in (table.start, table.goal))
    return {
        row: (tuple(start), tuple(goal))
        for row, start, goal in zip(rows.tolist(), starts, goals, strict=True)
    }


def _places(axes: Axes, ways: dict[int, tuple[Place, Place]], rules: NavigationSettings) -> None:
    """Marks every start by a dot with its configurations, and every goal by the circle to be reached."""
    starts: dict[Place, list[int]] = {}
    for row, (start, _) in ways.items():
        starts.setdefault(start, []).append(row)
    for place, rows in starts.items():
        axes.plot(*place, "o", color=GOAL, markersize=5)
        if len(ways) > MOST_NAMES:
            continue
        name = ",".join(f"c{row}" for row in rows)
        axes.annotate(name, place, textcoords="offset points", xytext=(4, 5), fontsize=7, color=GOAL)
    for x, y in sorted({goal for _, goal in ways.values()}):
        radius = rules.goal_radius
        axes.add_patch(Circle((x, y), radius, facecolor="none", edgecolor=GOAL, linewidth=0.6, zorder=1.5))
