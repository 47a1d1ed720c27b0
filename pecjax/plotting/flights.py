"""Flights from above: each by how it ended."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch

from pecjax.plotting.style import FAILURES, PATH, TIMEOUT, name_place
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import trajectory_table


class Ending(NamedTuple):
    """How flights that ended in one way look, and are spoken of.

    Attributes:
        label: of the legend.
        words: after a number of them.
        mark: where one ended; none of flights that succeeded.
    """

    label: str
    words: str
    color: str
    mark: str

    def entry(self) -> Line2D:
        """Its line in a legend."""
        return Line2D([], [], color=self.color, marker=self.mark, markersize=5, label=self.label)


ENDINGS = {
    "goal": Ending("Flight to the goal", "reach their goal", PATH, ""),
    "collision": Ending("Flight into a wall", "collide", FAILURES, "X"),
    "timeout": Ending("Flight out of time", "run out of time", TIMEOUT, "s"),
    "other": Ending("Flight that failed", "fail", FAILURES, "P"),
}


def flights_of(run: RunDirectory) -> pd.DataFrame:
    """The table of a run's flights (see `trajectory_table`) with a column `ending`, one of `ENDINGS`.

    Raises:
        InputError: the run is not finished.
    """
    table, kept = trajectory_table(run), run.iterations("episodes")
    arrays = run.arrays("episodes", kept[-1]) if kept else {}
    ending = np.where(table.success == 1, "goal", "other").astype(object)
    for kind in ("collision", "timeout"):
        if kind in arrays:
            ending[(table.success != 1) & (arrays[kind][table.episode] > 0)] = kind
    return table.assign(ending=ending)


def draw_flights(axes: Axes, trajectories: pd.DataFrame) -> None:
    """The flights with an arrow half way; where one failed, its mark and its configuration."""
    named = set()
    for _, path in trajectories.groupby("episode"):
        about, points = ENDINGS[path.ending.iloc[0]], path[["x", "y"]].to_numpy()
        failed = bool(about.mark)
        style = {"color": about.color, "linewidth": 1.2 if failed else 0.8, "alpha": 1 if failed else 0.6}
        axes.plot(*points.T, **style, zorder=2.5 if failed else 2)
        half = len(points) // 2
        if half:
            arrow = {"arrowstyle": "-|>", "mutation_scale": 8, "linewidth": 0, "zorder": 2.6}
            axes.add_patch(FancyArrowPatch(points[half - 1], points[half], color=about.color, **arrow))
        if failed:
            edge = {"markersize": 5, "markeredgecolor": "white", "markeredgewidth": 0.6}
            axes.plot(*points[-1], about.mark, color=about.color, zorder=5, **edge)
            name = f"c{path.config.iloc[0]}"
            if name not in named:
                name_place(axes, name, (points[-1, 0], points[-1, 1]))
            named.add(name)
    counts = trajectories.groupby("episode").ending.first().value_counts()
    parts = [f"{counts[kind]} {about.words}" for kind, about in ENDINGS.items() if kind in counts]
    axes.set_title(f"Of {counts.sum()} flights, {', '.join(parts)}", loc="left")
