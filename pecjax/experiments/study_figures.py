"""The figures of a study: the paper's, with intervals over seeds, and two that it lacks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pecjax.experiments.drawing import LEARNERS, save, snapshots, steps_axis, trials_and_failures
from pecjax.experiments.map_figure import success
from pecjax.experiments.measures import Interval, interval
from pecjax.experiments.study_directory import StudyDirectory
from pecjax.experiments.study_report import THRESHOLDS, StudyTables, by_run, read_study
from pecjax.world.coordinates import Configurations
from pecjax.world.scene import Scene, load_scene

# Colours that stay apart in grey with the dashes and marks beside them (Okabe & Ito).
STYLES = (
    ("#0072b2", "-", "o"),
    ("#d55e00", "--", "s"),
    ("#009e73", "-.", "^"),
    ("#333333", ":", "D"),
    ("#cc79a7", (0, (5, 1, 1, 1, 1, 1)), "v"),
    ("#56b4e9", (0, (1, 1)), "P"),
)
SMOOTHED_ITERATIONS = 20


def draw_study(folder: Path) -> list[Path]:
    """Draws every figure of a study, for each set of coordinates, into its `figures` folder.

    Raises:
        InputError: the folder holds no study, or none of its slices is finished.
    """
    directory = StudyDirectory(folder)
    settings = directory.settings()
    everything = read_study(folder)
    scene = load_scene(directory.scene_path, settings.run.resolution)
    paths = []
    for coordinates in settings.coordinates:
        tables = StudyTables(*(table.loc[table.coordinates == coordinates] for table in everything))
        if tables.results.empty:
            continue
        seeds = tables.results.groupby("condition").seed.nunique()
        number = f"{seeds.max()}" if seeds.min() == seeds.max() else f"{seeds.min()} to {seeds.max()}"
        title = (
            f"{settings.name}: {LEARNERS[settings.run.algorithm]}, coordinates {Path(coordinates).stem}, "
            f"{number} seed{'' if number == '1' else 's'}"
        )
        for name, figure in _figures(tables, scene, directory.table(coordinates)):
            figure.suptitle(title, fontsize=10)
            stem = name if len(settings.coordinates) == 1 else f"{name}-{Path(coordinates).stem}"
            paths.extend(save(figure, folder / "figures" / stem))
    return paths


def _figures(tables: StudyTables, scene: Scene, table: Configurations) -> Iterator[tuple[str, Figure]]:
    runs = by_run(tables)
    yield "goal_ratio", goal_ratio(tables)
    yield "evaluation", evaluation(tables.results)
    yield "spread", spread(tables.configurations)
    yield "exit", exits(tables.metrics, runs)
    yield "steps_to_threshold", steps_to_threshold(runs)
    yield "map", maps(tables.results, scene, table)
    for condition, rows in tables.configurations.groupby("condition", sort=False):
        yield f"configurations-{condition.replace(', α = ', '-')}", configurations(rows)
    if tables.results.alpha.nunique() > 1:
        yield "alpha", alphas(tables)


def _conditions(table: pd.DataFrame) -> Iterator[tuple[Any, pd.DataFrame, tuple]]:
    by_condition = table.groupby("condition", sort=False)
    for number, (condition, rows) in enumerate(by_condition):
        yield condition, rows, STYLES[number % len(STYLES)]


def _curves(axes: Axes, table: pd.DataFrame, column: str, label: str, marks: bool = False) -> None:
    """A line of interquartile means for each condition, and its interval as a band."""
    for condition, rows, (color, dashes, mark) in _conditions(table):
        by_iteration = rows.pivot(index="iteration", columns="seed", values=column).dropna()
        found = np.array([interval(row) for row in by_iteration.to_numpy()])
        if not len(found):
            continue
        style = {"marker": mark, "markersize": 3.5} if marks else {}
        axes.plot(by_iteration.index, found[:, 0], color=color, linestyle=dashes, label=condition, **style)
        axes.fill_between(by_iteration.index, found[:, 1], found[:, 2], color=color, alpha=0.18, linewidth=0)
    axes.set(xlabel="iteration", ylabel=label)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)


def _smooth(metrics: pd.DataFrame, most: int = 100) -> pd.DataFrame:
    """Training goal ratios, each the mean of those before it, at no more than so many iterations."""
    every = max(1, metrics.iteration.max() // most)
    by_run = metrics.groupby(["condition", "seed"], sort=False).goal_ratio
    mean = by_run.transform(lambda ratios: ratios.rolling(SMOOTHED_ITERATIONS, min_periods=1).mean())
    return metrics.assign(goal_ratio=mean).loc[metrics.iteration % every == 0]


def goal_ratio(tables: StudyTables) -> Figure:
    """Goal ratio against iteration, in training and on the uniform evaluation (Fig. 4, 8)."""
    figure = Figure((9.6, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _curves(left, _smooth(tables.metrics), "goal_ratio", "goal ratio")
    left.set_title(f"training, the sampler's own draw (mean of {SMOOTHED_ITERATIONS})", fontsize=9)
    _curves(right, tables.results, "goal_ratio", "", marks=True)
    right.set_title("uniform evaluation", fontsize=9)
    for axes in (left, right):
        axes.set_ylim(0, 1.02)
        steps_axis(axes, _batch(tables.metrics))
    right.legend(title="interquartile mean, 95 % interval", fontsize=8, title_fontsize=8, loc="lower right")
    return figure


def _batch(table: pd.DataFrame) -> float:
    return table.env_steps.iloc[0] / table.iteration.iloc[0]


def evaluation(results: pd.DataFrame) -> Figure:
    """What the uniform evaluations found: goal ratio, worst tenth and return (Fig. 7)."""
    figure = Figure((11.4, 3.6), layout="constrained")
    columns = {
        "goal_ratio": "goal ratio",
        "cvar": "goal ratio of the worst tenth (CVaR)",
        "mean_return": "mean return",
    }
    for axes, (column, label) in zip(figure.subplots(1, 3), columns.items(), strict=True):
        _curves(axes, results, column, label, marks=True)
        if column != "mean_return":
            axes.set_ylim(0, 1.02)
    figure.axes[0].legend(fontsize=8, loc="lower right")
    return figure


def spread(table: pd.DataFrame) -> Figure:
    """Mean and standard deviation over configurations of both ratios (Fig. 6, 10, 12)."""
    keys = ["condition", "seed", "iteration"]
    number = table.groupby(keys, sort=False).trials.transform("sum").clip(lower=1)
    ratios = table.assign(trial=table.trials / number, failure=table.failures / table.trials.clip(lower=1))
    by_run = ratios.groupby(keys, sort=False)
    figures = by_run.agg(
        trial_std=("trial", lambda x: x.std(ddof=0)),
        failure_mean=("failure", "mean"),
        failure_std=("failure", lambda x: x.std(ddof=0)),
    ).reset_index()
    figure = Figure((11.4, 3.6), layout="constrained")
    labels = {
        "trial_std": "trial ratio: standard deviation",
        "failure_mean": "failure ratio: mean",
        "failure_std": "failure ratio: standard deviation",
    }
    for axes, (column, label) in zip(figure.subplots(1, 3), labels.items(), strict=True):
        _curves(axes, figures, column, label, marks=True)
        axes.set_ylim(0, None)
    figure.axes[0].set_title(f"over configurations, since the beginning (mean 1/{_size(table)})", fontsize=9)
    figure.axes[1].legend(fontsize=8)
    return figure


def _size(table: pd.DataFrame) -> int:
    return int(table.config.max()) + 1


def exits(metrics: pd.DataFrame, runs: pd.DataFrame) -> Figure:
    """Training goal ratio, and where the paper's exit condition would have ended each run (Fig. 14)."""
    figure = Figure((6.8, 4.0), layout="constrained")
    axes = figure.subplots()
    _curves(axes, _smooth(metrics), "goal_ratio", f"training goal ratio (mean of {SMOOTHED_ITERATIONS})")
    batch = _batch(metrics)
    for place, (condition, rows, (color, _, mark)) in enumerate(_conditions(runs)):
        for at in THRESHOLDS:
            exit_at = rows[f"exit_at_{at:g}"].to_numpy() / batch
            height = np.full(len(rows), at + 0.012 * place)
            label = f"{condition}: exit" if at == THRESHOLDS[0] else None
            style = {"marker": mark, "facecolor": "white", "edgecolor": color, "label": label}
            axes.scatter(exit_at, height, s=22, zorder=3, **style)
    for at in THRESHOLDS:
        axes.axhline(at, color="0.6", linewidth=0.7, linestyle=":")
    axes.set_ylim(0, 1.04)
    steps_axis(axes, batch)
    axes.legend(title="exit: five iterations in a row held 0.90 or 0.95", fontsize=8, title_fontsize=8)
    return figure


def steps_to_threshold(runs: pd.DataFrame) -> Figure:
    """Steps until five evaluations in a row hold a threshold, a line for each seed."""
    figure = Figure((8.4, 4.0), layout="constrained")
    names = list(dict.fromkeys(runs.condition))
    values = runs[[f"steps_until_{at:g}" for at in THRESHOLDS]].to_numpy() / 1e6
    finite = values[np.isfinite(values)]
    never = 1.15 * finite.max() if len(finite) else 1.0
    for axes, at in zip(figure.subplots(1, 2, sharey=True), THRESHOLDS, strict=True):
        table = runs.pivot(index="seed", columns="condition", values=f"steps_until_{at:g}")[names] / 1e6
        shown = table.replace(np.inf, never)
        for _, row in shown.iterrows():
            axes.plot(range(len(names)), row, color="0.7", linewidth=0.8, zorder=1)
        for place, name in enumerate(names):
            color, _, mark = STYLES[place % len(STYLES)]
            axes.scatter(np.full(len(shown), place), shown[name], color=color, marker=mark, s=24, zorder=2)
            median = shown[name].median()
            axes.plot([place - 0.22, place + 0.22], [median, median], color="black", linewidth=1.6, zorder=3)
        if np.isinf(table.to_numpy()).any():
            axes.axhline(never, color="0.6", linewidth=0.7, linestyle=":")
            axes.annotate("not held", (len(names) - 0.5, never), fontsize=8, ha="right", va="bottom")
        axes.set_xticks(range(len(names)), [name.replace(", ", "\n") for name in names], fontsize=8)
        axes.set(xlim=(-0.5, len(names) - 0.5), ylim=(0, 1.08 * never))
        axes.set_title(f"goal ratio {at:g} held by five uniform evaluations", fontsize=9)
        axes.grid(alpha=0.3, axis="y")
    figure.axes[0].set_ylabel("environment steps (millions); bar: median")
    return figure


def maps(results: pd.DataFrame, scene: Scene, table: Configurations) -> Figure:
    """The map with the last evaluation's goal ratio of every pair, a panel for each condition."""
    last = results[results.iteration == results.iteration.max()]
    by_condition = list(last.groupby("condition", sort=False))
    figure = Figure((4.6 * len(by_condition) + 0.8, 5.0), layout="constrained")
    panels = figure.subplots(1, len(by_condition), sharey=True, squeeze=False)[0]
    columns = [f"c{config}" for config in range(table.size)]
    shades = []
    for axes, (condition, rows) in zip(panels, by_condition, strict=True):
        shades.append(success(axes, scene, table, rows[columns].mean().to_numpy()))
        axes.set_title(f"{condition}: {rows.goal_ratio.mean():.3f} of all reach the goal", fontsize=9)
        axes.label_outer()
    figure.colorbar(shades[0], ax=list(panels), label="goal ratio, mean over seeds", shrink=0.7, extend="min")
    return figure


def configurations(table: pd.DataFrame) -> Figure:
    """Trial ratio (bars) and failure ratio (line) at chosen iterations (Fig. 5, 9, 11, 13)."""
    chosen = snapshots(sorted(set(table.iteration)))
    figure = Figure((3.2 * len(chosen), 3.4), layout="constrained")
    all_axes = figure.subplots(1, len(chosen), sharey=True, squeeze=False)[0]
    twins = []
    for axes, iteration in zip(all_axes, chosen, strict=True):
        rows = table.loc[table.iteration == iteration].groupby("config")[["trials", "failures"]].sum()
        twins.append(trials_and_failures(axes, rows.reset_index()))
        twins[-1].tick_params(labelright=iteration == chosen[-1])
        axes.set_title(f"{table.condition.iloc[0]}, iteration {iteration}", fontsize=9)
    all_axes[0].set_ylabel("trial ratio (bars), all seeds")
    twins[-1].set_ylabel("failure ratio (line)")
    return figure


def alphas(tables: StudyTables) -> Figure:
    """How the end of training depends on α (Fig. 11-12): failures since the beginning, evaluation."""
    last = tables.configurations.iteration.max()
    counts = tables.configurations[tables.configurations.iteration == last]
    failure = counts.assign(failure=counts.failures / counts.trials.clip(lower=1))
    failures = failure.groupby(["alpha", "seed"]).failure.mean()
    results = tables.results[tables.results.iteration == last].set_index(["alpha", "seed"])
    figure = Figure((9.6, 3.6), layout="constrained")
    panels = {
        "failure ratio since the beginning": {"mean over configurations": failures},
        "goal ratio, last uniform evaluation": {
            "all configurations": results.goal_ratio,
            "worst tenth (CVaR)": results.cvar,
        },
    }
    for axes, (label, lines) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        for (name, values), (color, dashes, mark) in zip(lines.items(), STYLES, strict=False):
            found = {alpha: interval(x.to_numpy()) for alpha, x in values.groupby("alpha")}
            _error_bars(axes, found, color=color, linestyle=dashes, marker=mark, label=name)
        axes.set(xlabel="α", ylabel=label)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return figure


def _error_bars(axes: Axes, found: dict[float, Interval], **style: Any) -> None:
    value, low, high = np.array(list(found.values())).T
    error = np.nan_to_num([value - low, high - value])
    axes.errorbar(list(found), value, error, capsize=3, markersize=4, **style)
