"""The map from above, with configurations and flights (Fig. 2-3)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, Patch, Rectangle

from pecjax.envs.axes import fill
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.map_file import Map
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.scene import Scene
from pecjax.plotting.flights import LOOKS, draw_flights
from pecjax.plotting.style import GOAL, PAGE, name_place, styled

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
COVER: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.8", "linewidth": 0.6, "zorder": 0.6}
MOST_NAMES = 60  # of configurations; more would hide the map
MOST_WAYS = 200  # beyond which only configurations with a flight are drawn


@styled
def rooms(
    scene: Scene,
    table: Configurations,
    trajectories: pd.DataFrame | None = None,
    rules: NavigationSettings = NavigationSettings(),
    map_id: int = 0,
) -> Figure:
    """The map with its configurations or, if there are any, the flights that were flown (Fig. 2-3).

    Args:
        scene: one of the task's maps; configurations in others are left out.
        trajectories: columns episode, config, ending (one of `LOOKS`), x and y, a row a step.
        rules: of the task.
        map_id: the map's place among the task's.
    """
    (left, bottom), (right, top) = scene.map.bounds
    shape = (top - bottom) / (right - left)
    figure = Figure((PAGE, float(np.clip(5.0 * shape + 0.4, 2, 7))), layout="constrained")
    axes = figure.subplots()
    floor_plan(axes, scene.map, scene.drone_radius, rules)
    ways = ways_of(table, map_id)
    if trajectories is None:
        for start, goal in ways.values():
            way = {"linestyle": ":", "linewidth": 0.7, "color": "0.5", "shrinkA": 0, "shrinkB": 3}
            axes.add_patch(FancyArrowPatch(start, goal, arrowstyle="-|>", mutation_scale=7, zorder=1, **way))
    else:
        draw_flights(axes, trajectories)
        if len(ways) > MOST_WAYS:
            ways = {row: ways[row] for row in sorted(set(trajectories.config)) if row in ways}
    draw_places(axes, ways, rules, prefix="c" if trajectories is None else None)
    figure.legend(handles=_legend(axes, trajectories, rules), loc="outside right upper")
    return figure


def _legend(axes: Axes, trajectories: pd.DataFrame | None, rules: NavigationSettings) -> list[Artist]:
    """An entry for each kind of thing that the map shows."""
    ring = {"marker": "o", "markersize": 9, "markerfacecolor": "none", "linestyle": ""}
    entries: list[Artist] = [
        Line2D([], [], color=GOAL, marker="o", markersize=4, linestyle="", label="Start"),
        Line2D([], [], color=GOAL, **ring, label=f"Goal, reached within {rules.goal_radius:g} m"),
    ]
    if trajectories is None:
        entries.append(Line2D([], [], color="0.5", linestyle=":", label="From start to goal"))
    else:
        entries += [about.entry() for kind, about in LOOKS.items() if kind in set(trajectories.ending)]
    entries.append(Patch(**SOLID, label="Wall"))
    if any(patch.get_hatch() for patch in axes.patches):
        entries.append(Patch(**PASSED, label="Wall below or above flights"))
    return entries


def floor_plan(axes: Axes, one: Map, radius: float, rules: NavigationSettings = NavigationSettings()) -> None:
    """The walls of a map from above, in metres: solid what a drone can hit at its flight height.

    Walls that it flies over or under are hatched; a floor or a ceiling is outlined only.

    Args:
        radius: m, of the drone.
    """
    limits = one.bounds
    for lower, upper in zip(one.lower, one.upper, strict=True):
        (x, y), (right, top) = np.clip([lower[:2], upper[:2]], *limits)
        style = _wall_style(limits, radius, rules.flight_height, lower, upper)
        axes.add_patch(Rectangle((x, y), right - x, top - y, **style))
    (left, bottom), (right, top) = limits
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.locator_params(steps=[1, 2, 5, 10])


def _wall_style(
    limits: np.ndarray, radius: float, height: float, lower: np.ndarray, upper: np.ndarray
) -> dict[str, Any]:
    if lower[2] - radius <= height <= upper[2] + radius:
        return SOLID
    (low, high), inside = limits, np.clip([lower[:2], upper[:2]], *limits)
    covered = np.prod(inside[1] - inside[0]) / np.prod(high - low)
    return COVER if covered > 0.5 else PASSED


def ways_of(table: Configurations, map_id: int = 0) -> dict[int, tuple[Place, Place]]:
    """Start and goal of each configuration in one map, by its number."""
    rows = np.flatnonzero(np.asarray(fill(table).map_id) == map_id)
    starts, goals = (np.asarray(part)[rows].tolist() for part in (table.start, table.goal))
    return {
        row: (tuple(start), tuple(goal))
        for row, start, goal in zip(rows.tolist(), starts, goals, strict=True)
    }


def draw_places(
    axes: Axes, ways: dict[int, tuple[Place, Place]], rules: NavigationSettings, prefix: str | None
) -> None:
    """Marks every start by a dot, and every goal by the circle to be reached.

    Args:
        prefix: of the configurations' numbers, which are written beside their start where they are not too
            many; with None they are not.
    """
    starts: dict[Place, list[int]] = {}
    for row, (start, _) in ways.items():
        starts.setdefault(start, []).append(row)
    for place, rows in starts.items():
        axes.plot(*place, "o", color=GOAL, markersize=4, markeredgecolor="white", zorder=4)
        if prefix is not None and len(ways) <= MOST_NAMES:
            name_place(axes, ",".join(f"{prefix}{row}" for row in rows), place)
    for goal in sorted({goal for _, goal in ways.values()}):
        ring = {"facecolor": "none", "edgecolor": GOAL, "linewidth": 0.7, "zorder": 3}
        axes.add_patch(Circle(goal, rules.goal_radius, **ring))
