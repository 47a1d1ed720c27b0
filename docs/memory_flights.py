"""The flights of memory.md: two policies, without a memory and with one, in the same held-out plans.

    python docs/memory_flights.py WITHOUT WITH     # the folders of two runs; into docs/images/results

It prints in how many plans each reaches its goal, and draws the first of those in which only one does.
"""

from __future__ import annotations

import argparse
import dataclasses
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
from pecjax.training.evaluation import EvalResult
from pecjax.training.load import Trained, open_run
from pecjax.viewing.recording import map_of

HERE = Path(__file__).parent
DPI = 200
LABELS, COLORS = ("No memory", "Memory"), (RED, BLUE)


def fly(folder: Path) -> tuple[Trained, EvalResult]:
    """Every held-out plan once, by the most likely actions; sorted by plan."""
    trained = open_run(folder)
    episodes = len(jax.tree.leaves(trained.run.eval_set.table)[0])
    about = dataclasses.replace(trained.settings.evaluation, episodes=episodes)
    settings = dataclasses.replace(trained.settings, evaluation=about)
    result = jax.tree.map(np.asarray, trained._replace(settings=settings).evaluator()())
    return trained, jax.tree.map(lambda leaf: leaf[np.argsort(result.config_id)], result)


def cases_of(without: np.ndarray, remembers: np.ndarray) -> dict[str, np.ndarray]:
    """The plans in which only one reaches its goal, both do, and neither does."""
    cases = {
        "only with a memory": remembers & ~without,
        "only without": without & ~remembers,
        "both": without & remembers,
        "neither": ~without & ~remembers,
    }
    return {name: np.flatnonzero(case) for name, case in cases.items()}


def sheet(
    runs: tuple[Trained, Trained], flights: tuple[EvalResult, EvalResult], rows: list[np.ndarray]
) -> Figure:
    """Plans from above with both flights, a row of plans for each given."""
    columns = max(map(len, rows))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(PAGE, PAGE / columns * len(rows) + 0.3), layout="constrained")
        for line, plans in zip(figure.subplots(len(rows), columns, squeeze=False), rows, strict=True):
            for axes in line:
                axes.set_axis_off()
            for axes, number in zip(line, plans, strict=False):
                _plan(axes, runs, flights, int(number))
        entries = [
            Line2D([], [], color=color, label=label) for label, color in zip(LABELS, COLORS, strict=True)
        ]
        ends = {"marker": "X", "linestyle": "", "color": "0.4", "label": "Collision"}
        entries += [Line2D([], [], **ends), Line2D([], [], **ends | {"marker": "s", "label": "Out of time"})]
        legend_below(figure, entries)
    return figure


def _plan(
    axes: Axes, runs: tuple[Trained, Trained], flights: tuple[EvalResult, EvalResult], number: int
) -> None:
    run = runs[0].run
    rules, table = run.task.settings, run.eval_world.table
    config = take_configs(table, number)
    floor_plan(axes, map_of(run.eval_world.params.bank, int(config.map_id)), run.task.vehicle.radius, rules)
    ends = [tuple(np.asarray(place)[:2].tolist()) for place in (config.start, config.goal)]
    draw_places(axes, {number: (ends[0], ends[1])}, rules, None)
    for flown, color in zip(flights, COLORS, strict=True):
        path = flown.poses[number, : flown.lengths[number] + 1, :2]
        axes.plot(*path.T, color=color, linewidth=1.1, alpha=0.9, zorder=3)
        if not flown.success[number]:
            mark = "X" if flown.metrics["collision"][number] else "s"
            axes.plot(*path[-1], mark, color=color, markersize=5, markeredgecolor="white", zorder=5)
    group = run.eval_set.groups[int(run.eval_set.group_id[number])]
    axes.set_title(f"{number}: {group}", fontsize=SMALL, pad=2)


def main(words: list[str] | None = None) -> None:
    """Flies and draws them."""
    parser = argparse.ArgumentParser(description="The flights of memory.md.")
    parser.add_argument("without", type=Path)
    parser.add_argument("remembers", type=Path)
    parser.add_argument("--out", type=Path, default=HERE / "images" / "results" / "memory-flights.png")
    given = parser.parse_args(words)
    (one, theirs), (other, ours) = fly(given.without), fly(given.remembers)
    cases = cases_of(theirs.success, ours.success)
    print({name: len(plans) for name, plans in cases.items()})
    rows = [cases["only with a memory"][:4], cases["only with a memory"][4:8], cases["only without"][:4]]
    sheet((one, other), (theirs, ours), rows).savefig(given.out, dpi=DPI)


if __name__ == "__main__":
    main()
