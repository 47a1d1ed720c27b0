"""The figures of one run, drawn from its plain files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.task import World
from pecjax.plotting.configurations import configurations
from pecjax.plotting.flights import flights_of
from pecjax.plotting.maps import rooms
from pecjax.plotting.style import (
    BLACK,
    COLUMN,
    FAILURES,
    PAGE,
    PATH,
    RATIO_LIMITS,
    TRIALS,
    by_iteration,
    legend_below,
    name_panels,
    save,
    set_title,
    smoothed,
    steps_axis,
    styled,
    window,
)
from pecjax.storage.tables import read_table
from pecjax.studies.grid import shown_space, space_name
from pecjax.studies.statistics import effective_number, trial_and_failure_ratios
from pecjax.training.kinds import AGENT_LABELS, kind_name, sampler_label
from pecjax.training.measures import wilson
from pecjax.training.run_arrays import run_arrays
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import configuration_table
from pecjax.training.settings import RunSettings

_COLUMNS = {
    "metrics": {"iteration", "env_steps", "goal_ratio"},
    "evaluation": {"iteration", "goal_ratio", "mean_return"},
}
MOST_MARKS = 20  # of a line; more would hide it
_INTERVAL = "95 % interval (Wilson), n = {:,} episodes"


def draw_run(folder: Path) -> list[Path]:
    """Draws every figure of one run as PDF and PNG into its `figures` folder.

    Raises:
        InputError: the folder holds no finished run.
    """
    run = RunDirectory(folder)
    settings = run.settings()
    metrics, evaluation = (read_table(folder / f"{name}.csv", columns) for name, columns in _COLUMNS.items())
    counts, about = configuration_table(run), settings.evaluation
    figures = {
        "goal_ratio": goal_ratio(metrics, evaluation, about.episodes, about.greedy),
        "configurations": configurations(counts),
        "spread": spread(counts),
        "evaluation": evaluations(evaluation, _returns(run), about.episodes, about.greedy),
    }
    task = run.task()
    if isinstance(task, Rooms):
        figures["map"] = _one_map(task, flights_of(run))
    for figure in figures.values():
        set_title(figure, _title(settings))
    return [path for name, figure in figures.items() for path in save(figure, folder / "figures" / name)]


def _title(settings: RunSettings) -> str:
    agent = kind_name(settings.agent)
    space = shown_space(space_name(settings))
    sampler = sampler_label(settings.sampler)
    return f"{AGENT_LABELS.get(agent, agent)} with {sampler} on {space}, seed {settings.seed}"


def _one_map(task: Rooms, flights: pd.DataFrame) -> Figure:
    """The first of the task's maps that has a configuration, with what is flown in it."""
    table = task.eval_set(World(None, task.configurations())).table
    map_id = np.asarray(table.map_id)
    shown = int(map_id.min())
    flown = flights.loc[flights.config.isin(np.flatnonzero(map_id == shown))]
    return rooms(task.scene(shown), table, flown, task, shown)


def _returns(run: RunDirectory) -> dict[int, np.ndarray]:
    """The returns (E,) of the episodes of each evaluation; version 0.1 kept none."""
    found = {}
    for at in run.iterations("episodes"):
        with run_arrays(run, "episodes", at) as arrays:
            found[at] = arrays["return"].astype(float).ravel()
    return found


def _actions(greedy: bool) -> str:
    return "greedy actions" if greedy else "sampled actions"


def _wilson(ratios: pd.Series, episodes: int) -> tuple[np.ndarray, np.ndarray]:
    """The ends (E,) of the intervals of goal ratios of so many episodes each."""
    low, high = np.array([wilson(round(ratio * episodes), episodes) for ratio in ratios]).T
    return low, high


def _mean_interval(values: np.ndarray) -> tuple[float, float]:
    """The 95 % interval of a mean by Student's t; NaN below two values."""
    if len(values) < 2:
        return float("nan"), float("nan")
    half = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values)
    return float(values.mean() - half), float(values.mean() + half)


@styled
def goal_ratio(metrics: pd.DataFrame, evaluation: pd.DataFrame, episodes: int, greedy: bool) -> Figure:
    """Goal ratio against iteration, in training and on the uniform evaluation (Fig. 4)."""
    figure = Figure((COLUMN, 2.6), layout="constrained")
    axes = figure.subplots()
    line = {"color": TRIALS, "linewidth": 0.6, "label": "Training, every iteration"}
    axes.plot(metrics.iteration, metrics.goal_ratio, **line)
    label = f"Training, centred mean of {window(len(metrics))} iterations"
    axes.plot(metrics.iteration, smoothed(metrics.goal_ratio), color=PATH, label=label)
    low, high = _wilson(evaluation.goal_ratio, episodes)
    errors = np.clip([evaluation.goal_ratio - low, high - evaluation.goal_ratio], 0, None)
    label = f"Uniform evaluation, {_actions(greedy)}, {_INTERVAL.format(episodes)}"
    style = {"fmt": "o", "color": BLACK, "elinewidth": 0.8, "label": label}
    axes.errorbar(evaluation.iteration, evaluation.goal_ratio, errors, **style)
    axes.set(ylabel="Goal ratio", ylim=RATIO_LIMITS, xlim=(0, 1.03 * metrics.iteration.max()))
    by_iteration(axes)
    steps_axis(axes, metrics.env_steps.iloc[0] / metrics.iteration.iloc[0])
    legend_below(figure)
    return figure


@styled
def spread(table: pd.DataFrame) -> Figure:
    """How many configurations the draws come to, and how unlike their failure ratios are (Fig. 6)."""
    ratios = trial_and_failure_ratios(table, ["iteration"])
    size = table.config.nunique()
    figure = Figure((PAGE, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    drawn = ratios.groupby("iteration").trial.agg(effective_number)
    some = {"markevery": max(1, len(drawn) // MOST_MARKS)}
    left.plot(drawn.index, drawn, "o-", color=PATH, label="Of the trials since the beginning", **some)
    if "probability" in table:
        next_ones = table.groupby("iteration").probability.agg(effective_number)
        label = "Of the sampler at that moment"
        left.plot(next_ones.index, next_ones, "s--", color=FAILURES, label=label, **some)
    left.axhline(size, color=BLACK, linewidth=0.8, linestyle=":", label=f"All {size:,} alike")
    left.set(ylabel="Effective number", ylim=(0, 1.08 * size))
    failure = ratios.groupby("iteration").failure
    low, middle, high = (failure.quantile(part) for part in (0.1, 0.5, 0.9))
    right.fill_between(
        low.index, low, high, color=FAILURES, alpha=0.25, linewidth=0, label="10th to 90th percentile of them"
    )
    label = f"Median of n = {size:,} configurations"
    right.plot(middle.index, middle, "o-", color=FAILURES, label=label, **some)
    right.plot(failure.mean().index, failure.mean(), "-.", color=BLACK, label="Mean")
    right.set(ylabel="Failure ratio", ylim=(0, None))
    name_panels([left, right], ["Configurations drawn, exp(entropy)", "Failures since the beginning"])
    for axes in (left, right):
        by_iteration(axes)
    legend_below(figure)
    return figure


@styled
def evaluations(
    evaluation: pd.DataFrame, returns: dict[int, np.ndarray], episodes: int, greedy: bool
) -> Figure:
    """Goal ratio and return at every checkpoint, on the uniform evaluation (Fig. 7).

    Args:
        returns: (E,) of each evaluation whose episodes were kept, by iteration.
    """
    figure = Figure((PAGE, 2.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    band = {"alpha": 0.2, "linewidth": 0}
    low, high = _wilson(evaluation.goal_ratio, episodes)
    left.fill_between(evaluation.iteration, low, high, color=PATH, **band, label=_INTERVAL.format(episodes))
    left.plot(evaluation.iteration, evaluation.goal_ratio, "o-", color=PATH, label="Goal ratio")
    left.set(ylabel="Goal ratio", ylim=RATIO_LIMITS)
    if returns:
        ends = np.array([_mean_interval(of_one) for of_one in returns.values()])
        label = f"95 % interval (t), n = {episodes:,} episodes"
        right.fill_between([*returns], *ends.T, color=PATH, **band, label=label)
    right.plot(evaluation.iteration, evaluation.mean_return, "o-", color=PATH, label="Mean return")
    right.set(ylabel="Mean return (reward)")
    right.margins(y=0.1)
    name_panels([left, right], [f"{what}, {_actions(greedy)}" for what in ("Success", "Return")])
    for axes in (left, right):
        axes.set_xlim(0, 1.03 * evaluation.iteration.max())
        by_iteration(axes)
    legend_below(figure)
    return figure
