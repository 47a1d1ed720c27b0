"""The map of a study: how often each pair of start and goal was flown with success."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable, viridis
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.geodesics import shortest_ways
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.scene import Scene
from pecjax.envs.rooms.spaces.pairs import make_site
from pecjax.plotting.maps import MOST_NAMES, Place, draw_places, floor_plan, ways_of

COLORS = LinearSegmentedColormap.from_list("dark", viridis(np.linspace(0, 0.9, 64)))
ASIDE = 0.25  # m, by which a path around walls is drawn to the right of where it is
SMOOTHED = 7  # of its points, over which corners are rounded


def success(
    axes: Axes,
    scene: Scene,
    table: Configurations,
    ratios: np.ndarray,
    rules: NavigationSettings,
    low: float = 0,
) -> ScalarMappable:
    """The map with an arrow for every configuration, coloured by its goal ratio, the lower the broader.

    A pair and its reverse lie apart, each to the right of its way. Where walls are between the two places,
    the arrow takes the shortest path around them, if there is one with room for the arrow too.

    Args:
        scene: the first of the task's maps.
        ratios: (N,), of all configurations.
        low: the ratio at which the colours begin.

    Returns:
        what a colour bar needs.
    """
    shade = ScalarMappable(Normalize(low, 1), COLORS)
    floor_plan(axes, scene.map, scene.drone_radius, rules)
    ways = ways_of(table)
    arrows = _arrows(scene, ways, rules)
    for row in sorted(ways, key=lambda row: -ratios[row]):  # the lowest lie on top
        width = 0.8 + 1.6 * (1 - ratios[row]) / (1 - low)
        look = {"linewidth": width, "color": shade.to_rgba(ratios[row]), "zorder": 2}
        axes.add_patch(FancyArrowPatch(**arrows[row], arrowstyle="-|>", mutation_scale=6, **look))
    draw_places(axes, ways, rules, prefix="")  # several maps side by side have room for little
    return shade


def _arrows(
    scene: Scene, ways: dict[int, tuple[Place, Place]], rules: NavigationSettings
) -> dict[int, dict[str, Any]]:
    """Where the arrow of each configuration runs: an arc, or around walls."""
    arc = {"connectionstyle": "arc3,rad=0.12", "shrinkA": 3, "shrinkB": 3}
    arrows: dict[int, dict[str, Any]] = {
        row: {"posA": start, "posB": goal, **arc} for row, (start, goal) in ways.items()
    }
    if not 0 < len(ways) <= MOST_NAMES:
        return arrows
    paths = make_site(scene.map, scene.drone_radius + ASIDE, rules.flight_height).paths
    starts, goals = np.array(list(ways.values())).swapaxes(0, 1)
    for row, way in zip(ways, shortest_ways(paths, starts, goals), strict=True):
        if len(way.points) > 2:
            arrows[row] = {"path": Path(_aside(way.points, rules.goal_radius / 2))}
    return arrows


def _aside(points: np.ndarray, ends: float) -> np.ndarray:
    """A path (P, 2) m moved to its right, with round corners.

    Args:
        ends: m, which are left out where it starts and where it ends.
    """
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    places = np.arange(ends, length[-1] - ends, 0.2)
    even = np.stack([np.interp(places, length, axis) for axis in points.T], axis=-1)
    half = SMOOTHED // 2
    padded = np.pad(even, ((half, half), (0, 0)), "reflect", reflect_type="odd")
    smooth = np.lib.stride_tricks.sliding_window_view(padded, SMOOTHED, axis=0).mean(axis=-1)
    along = np.gradient(smooth, axis=0)
    right = along[:, ::-1] * [1, -1]
    return smooth + ASIDE * right / np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-9)
