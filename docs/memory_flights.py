"""The flights of memory.md: two policies, without a memory and with one, in the same held-out plans.

    python docs/memory_flights.py WITHOUT WITH     # the folders of two runs; into docs/images/results

It prints in how many plans each reaches its goal, and draws the first of those in which only one does.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pecjax.envs.task import take_configs
from pecjax.plotting.maps import draw_places, floor_plan
from pecjax.plotting.style import BLUE, PAGE, RED, SMALL, STYLE, legend_below
from pecjax.training.build import Run
from pecjax.training.load import open_run
from pecjax.training.run_episodes import EvalResult
from pecjax.viewing.recording import map_of

HERE = Path(__file__).parent
DPI = 200
LABELS, LINES = ("No memory", "Memory"), (RED, BLUE)  # as in memory_pictures.py


def fly(folder: Path) -> tuple[Run, EvalResult]:
    """Every held-out plan once, by the most likely actions; sorted by plan."""
    trained = open_run(folder)
    episodes = len(jax.tree.leaves(trained.run.eval_set.table)[0])
    about = dataclasses.replace(trained.settings.evaluation, episodes=episodes, greedy=True)
    settings = dataclasses.replace(trained.settings, evaluation=about)
    result = jax.tree.map(np.asarray, trained._replace(settings=settings).evaluator()())
    return trained.run, jax.tree.map(lambda leaf: leaf[np.argsort(result.config_id)], result)


def cases_of(without: np.ndarray, remembers: np.ndarray) -> dict[str, np.ndarray]:
    """The plans in which only one reaches its goal, both do, and neither does."""
    cases = {
        "only with a memory": remembers & ~without,
        "only without": without & ~remembers,
        "both": without & remembers,
        "neither": ~without & ~remembers,
    }
    return {name: np.flatnonzero(case) for name, case in cases.items()}


def sheet(flown: Run, flights: Sequence[EvalResult], rows: Sequence[np.ndarray]) -> Figure:
    """Plans from above with everybody's flight, a row for each of `rows` (some numbers of plans)."""
    columns = max(1, *map(len, rows))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(PAGE, PAGE / columns * len(rows) + 0.3), layout="constrained")
        for line, plans in zip(figure.subplots(len(rows), columns, squeeze=False), rows, strict=True):
            for axes in line:
                axes.set_axis_off()
            for axes, number in zip(line, plans, strict=False):
                _plan(axes, flown, flights, int(number))
        entries = [
            Line2D([], [], color=color, label=label) for label, color in zip(LABELS, LINES, strict=True)
        ]
        end = {"linestyle": "", "color": "0.4"}
        entries.append(Line2D([], [], marker="X", label="Collision", **end))
        entries.append(Line2D([], [], marker="s", label="Out of time", **end))
        legend_below(figure, entries)
    return figure


def _plan(axes: Axes, flown: Run, flights: Sequence[EvalResult], number: int) -> None:
    rules, about = flown.task.settings, flown.eval_set
    config = take_configs(about.table, number)
    walls = map_of(flown.eval_world.params.bank, int(config.map_id))
    floor_plan(axes, walls, flown.task.vehicle.radius, rules)
    start, goal = (tuple(np.asarray(place).tolist()) for place in (config.start, config.goal))
    draw_places(axes, {number: (start, goal)}, rules, None)
    for result, color in zip(flights, LINES, strict=True):
        path = result.poses[number, : result.lengths[number] + 1, :2]
        axes.plot(*path.T, color=color, linewidth=1.1, alpha=0.9, zorder=3)
        if not result.success[number]:
            mark = "X" if result.metrics["collision"][number] else "s"
            axes.plot(*path[-1], mark, color=color, markersize=5, markeredgecolor="white", zorder=5)
    axes.set_title(f"{number}: {about.groups[about.group_id[number]]}", fontsize=SMALL, pad=2)


def main(words: list[str] | None = None) -> None:
    """Flies and draws them."""
    parser = argparse.ArgumentParser(description="The flights of memory.md.")
    parser.add_argument("without", type=Path)
    parser.add_argument("remembers", type=Path)
    parser.add_argument("--out", type=Path, default=HERE / "images" / "results" / "memory-flights.png")
    given = parser.parse_args(words)
    runs, flights = zip(*(fly(folder) for folder in (given.without, given.remembers)), strict=True)
    tables = [jax.tree.leaves(run.eval_set.table) for run in runs]
    if not all(np.array_equal(one, other) for one, other in zip(*tables, strict=True)):
        parser.error("the runs have other held-out plans")
    cases = cases_of(*(flown.success for flown in flights))
    print({name: len(plans) for name, plans in cases.items()})
    only, lost = cases["only with a memory"], cases["only without"]
    sheet(runs[0], flights, [only[:4], only[4:8], lost[:4]]).savefig(given.out, dpi=DPI)


if __name__ == "__main__":
    main()
