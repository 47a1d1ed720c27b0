"""The figures of one run, drawn from its plain files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.task import World
from pecjax.plotting.configurations import configurations
from pecjax.plotting.maps import rooms
from pecjax.plotting.style import (
    FAILURES,
    GOAL,
    PATH,
    RATIO_LIMITS,
    SMOOTHED_ITERATIONS,
    TRIALS,
    save,
    steps_axis,
    whole_ticks,
)
from pecjax.storage.tables import read_table
from pecjax.studies.statistics import trial_and_failure_ratios
from pecjax.training.kinds import run_label
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import configuration_table, trajectory_table

_COLUMNS = {
    "metrics": {"iteration", "env_steps", "goal_ratio"},
    "evaluation": {"iteration", "goal_ratio", "mean_return"},
}


def draw_run(folder: Path) -> list[Path]:
    """Draws every figure of one run as PNG and SVG into its `figures` folder.

    Raises:
        InputError: the folder holds no finished run.
    """
    run = RunDirectory(folder)
    settings = run.settings()
    metrics, evaluation = (read_table(folder / f"{name}.csv", columns) for name, columns in _COLUMNS.items())
    counts, about = configuration_table(run), settings.evaluation
    figures = {
        "goal_ratio": goal_ratio(metrics, evaluation, about.greedy),
        "configurations": configurations(counts),
        "spread": spread(counts),
        "evaluation": evaluations(evaluation, about.episodes, about.greedy),
    }
    task = run.task()
    if isinstance(task, Rooms):
        figures["map"] = _one_map(task, trajectory_table(run))
    for figure in figures.values():
        figure.suptitle(run_label(settings), fontsize=10)
    return [path for name, figure in figures.items() for path in save(figure, folder / "figures" / name)]


def _one_map(task: Rooms, trajectories: pd.DataFrame) -> Figure:
    """The first of the task's maps that has a configuration, with what is flown in it."""
    table = task.eval_set(World(None, task.configurations())).table
    map_id = np.asarray(table.map_id)
    shown = int(map_id.min())
    flown = trajectories.loc[trajectories.config.isin(np.flatnonzero(map_id == shown))]
    return rooms(task.scene(shown), table, flown, task, shown)


def goal_ratio(metrics: pd.DataFrame, evaluation: pd.DataFrame, greedy: bool) -> Figure:
    """Goal ratio against iteration, in training and on the uniform evaluation (Fig. 4)."""
    figure = Figure((6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    smooth = metrics.goal_ratio.rolling(SMOOTHED_ITERATIONS, min_periods=1).mean()
    axes.plot(
        metrics.iteration, metrics.goal_ratio, color=TRIALS, linewidth=0.8, label="training, each iteration"
    )
    axes.plot(
        metrics.iteration,
        smooth,
        color=PATH,
        label=f"training, the sampler's own draw (mean of {SMOOTHED_ITERATIONS})",
    )
    axes.plot(
        evaluation.iteration,
        evaluation.goal_ratio,
        "o--",
        color=GOAL,
        markersize=4,
        label=f"uniform evaluation, {'greedy' if greedy else 'sampled'} actions",
    )
    axes.set(ylabel="goal ratio", ylim=RATIO_LIMITS, xlim=(0, 1.02 * metrics.iteration.max()))
    _by_iteration(axes)
    axes.legend(loc="lower right", fontsize=8)
    steps_axis(axes, metrics.env_steps.iloc[0] / metrics.iteration.iloc[0])
    return figure


def spread(table: pd.DataFrame) -> Figure:
    """Mean and standard deviation over configurations of both ratios (Fig. 6)."""
    ratios = trial_and_failure_ratios(table, ["iteration"])
    figure = Figure((8, 3.4), layout="constrained")
    for axes, name, color in zip(figure.subplots(1, 2), ("trial", "failure"), (PATH, FAILURES), strict=True):
        by_iteration = ratios.groupby("iteration")[name]
        mean, deviation = by_iteration.mean(), by_iteration.std(ddof=0)
        axes.plot(mean.index, mean, color=color, label="mean over configurations")
        axes.fill_between(
            mean.index,
            mean - deviation,
            mean + deviation,
            color=color,
            alpha=0.2,
            label="± standard deviation",
        )
        axes.set(ylabel=f"{name} ratio, since the beginning", ylim=(0, None))
        axes.legend(fontsize=8)
        _by_iteration(axes)
    return figure


def evaluations(evaluation: pd.DataFrame, episodes: int, greedy: bool) -> Figure:
    """Goal ratio and return at every checkpoint, on the uniform evaluation (Fig. 7)."""
    figure = Figure((8, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(evaluation.iteration, evaluation.goal_ratio, "o-", color=GOAL, markersize=4)
    left.set(ylabel="goal ratio", ylim=RATIO_LIMITS)
    right.plot(evaluation.iteration, evaluation.mean_return, "o-", color=PATH, markersize=4)
    right.set(ylabel="mean return")
    for axes in (left, right):
        _by_iteration(axes)
        axes.set_title(f"{episodes} {'greedy' if greedy else 'sampled'} episodes, uniform draw", fontsize=9)
    return figure


def _by_iteration(axes: Axes) -> None:
    axes.set_xlabel("iteration")
    whole_ticks(axes)
    axes.grid(alpha=0.3)
