"""Flights from above: each by how it ended."""

from __future__ import annotations

from typing import NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch

from pecjax.plotting.style import FAILURES, PATH, TIMEOUT, name_place
from pecjax.training.run_arrays import endings, run_arrays
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import trajectory_table


class Look(NamedTuple):
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


LOOKS = {
    "goal": Look("Flight to the goal", "reach their goal", PATH, ""),
    "collision": Look("Flight into a wall", "collide", FAILURES, "X"),
    "timeout": Look("Flight out of time", "run out of time", TIMEOUT, "s"),
    "other": Look("Flight that failed", "fail", FAILURES, "P"),
}


def flights_of(run: RunDirectory) -> pd.DataFrame:
    """The table of a run's flights (see `trajectory_table`) with a column `ending`, one of `ENDINGS`.

    Raises:
        InputError: the run is not finished.
    """
    table, kept = trajectory_table(run), run.iterations("episodes")
    if not kept:  # version 0.1 wrote whether a flight succeeded, and no more
        return table.assign(ending=endings({"success": table.success}))
    with run_arrays(run, "episodes", kept[-1]) as arrays:
        return table.assign(ending=endings(arrays)[table.episode])


def draw_flights(axes: Axes, trajectories: pd.DataFrame) -> None:
    """The flights with an arrow half way; where one failed, its mark and its configuration."""
    named = set()
    for _, path in trajectories.groupby("episode"):
        about, points = LOOKS[path.ending.iloc[0]], path[["x", "y"]].to_numpy()
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
    parts = [f"{counts[kind]} {about.words}" for kind, about in LOOKS.items() if kind in counts]
    axes.set_title(f"Of {counts.sum()} flights, {', '.join(parts)}", loc="left")
