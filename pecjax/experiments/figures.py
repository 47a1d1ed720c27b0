"""Figures: the paper's pictures, drawn from a run directory's plain files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from pecjax.errors import InputError
from pecjax.experiments.run_directory import RunDirectory
from pecjax.world.coordinates import Configurations
from pecjax.world.scene import Scene, load_scene

# Colours that stay apart in grey (Okabe & Ito).
TRIALS, FAILURES, GOAL, PATH = "#9fb8cc", "#a0330f", "#00573f", "#1f5f99"
LEARNERS = {"ppo": "PPO", "apex": "Ape-X DQN"}
SMOOTHED_ITERATIONS = 20
_COLUMNS = {
    "metrics": {"iteration", "env_steps", "goal_ratio"},
    "configurations": {"iteration", "config", "trials", "failures"},
    "evaluation": {"iteration", "goal_ratio", "mean_return"},
    "trajectories": {"episode", "config", "goal", "step", "x", "y"},
}
SNAPSHOTS = 4  # iterations shown side by side, as in the paper's Fig. 5

matplotlib.rcParams["svg.hashsalt"] = "pecjax"


def draw_run(folder: Path) -> list[Path]:
    """Draws every figure of one run as PNG and SVG into its `figures` folder.

    Raises:
        InputError: the folder holds no finished run.
    """
    run = RunDirectory(folder)
    settings = run.settings()
    tables = {name: _read(folder / f"{name}.csv", columns) for name, columns in _COLUMNS.items()}
    label = settings.sampler + (f" (α = {settings.alpha:g})" if settings.sampler == "pec" else "")
    label += f", {LEARNERS[settings.algorithm]}, coordinates {Path(settings.coordinates).name}"
    label += f", seed {settings.seed}"
    metrics, evaluation = tables["metrics"], tables["evaluation"]
    figures = {
        "goal_ratio": goal_ratio(metrics, evaluation, settings.greedy),
        "configurations": configurations(tables["configurations"]),
        "spread": spread(tables["configurations"]),
        "evaluation": evaluations(evaluation, settings.evaluation_episodes, settings.greedy),
        "map": rooms(load_scene(run.scene_path), run.table(), tables["trajectories"]),
    }
    for figure in figures.values():
        figure.suptitle(label, fontsize=10)
    return [path for name, figure in figures.items() for path in save(figure, folder / "figures" / name)]


def _read(path: Path, columns: set[str]) -> pd.DataFrame:
    if not path.is_file():
        raise InputError(f"{path}: missing; the run has not come to its end")
    try:
        table = pd.read_csv(path)
    except ValueError as error:  # pandas' own errors are of this kind
        raise InputError(f"{path}: not a table ({error}); the run must be done again") from error
    numeric = set(table.select_dtypes("number").columns)
    if not columns <= numeric or table.empty:
        lacking = ", ".join(sorted(columns - numeric)) or "rows"
        raise InputError(f"{path}: lacks {lacking}; the run must be done again")
    return table


def save(figure: Figure, path: Path) -> list[Path]:
    """Writes a figure as PNG and SVG; `path` is without their endings."""
    path.parent.mkdir(parents=True, exist_ok=True)
    paths = [path.with_name(path.name + suffix) for suffix in (".png", ".svg")]
    figure.savefig(paths[0], dpi=150)
    figure.savefig(paths[1], metadata={"Date": None})
    return paths


def goal_ratio(metrics: pd.DataFrame, evaluation: pd.DataFrame, greedy: bool) -> Figure:
    """Goal ratio against iteration, in training and on the uniform evaluation (Fig. 4)."""
    figure = Figure((6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    smooth = metrics.goal_ratio.rolling(SMOOTHED_ITERATIONS, min_periods=1).mean()
    axes.plot(metrics.iteration, metrics.goal_ratio, color=TRIALS, linewidth=0.8)
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
    axes.set(xlabel="iteration", ylabel="goal ratio", ylim=(0, 1.02), xlim=(0, metrics.iteration.max()))
    axes.legend(loc="lower right", fontsize=8)
    axes.grid(alpha=0.3)
    _steps_axis(axes, metrics)
    return figure


def _steps_axis(axes: Axes, metrics: pd.DataFrame) -> None:
    batch = metrics.env_steps.iloc[0] / metrics.iteration.iloc[0] / 1e6
    steps: tuple[Callable, Callable] = (lambda i: i * batch, lambda s: s / batch)
    axes.secondary_xaxis("top", functions=steps).set_xlabel("environment steps (millions)")


def configurations(table: pd.DataFrame) -> Figure:
    """Trial ratio (bars) and failure ratio (line) per configuration at chosen iterations (Fig. 5)."""
    iterations = np.unique(table.iteration)
    wanted = np.linspace(0, iterations[-1], SNAPSHOTS + 1)[1:]
    chosen = sorted({int(iterations[np.abs(iterations - w).argmin()]) for w in wanted})
    figure = Figure((3.2 * len(chosen), 3.2), layout="constrained")
    all_axes = figure.subplots(1, len(chosen), sharey=True, squeeze=False)[0]
    twins = [axes.twinx() for axes in all_axes]
    for axes, twin, iteration in zip(all_axes, twins, chosen, strict=True):
        rows = table[table.iteration == iteration]
        axes.bar(rows.config, rows.trials / max(rows.trials.sum(), 1), color=TRIALS, label="trial ratio")
        ratio = rows.failures / rows.trials.where(rows.trials > 0)
        twin.plot(rows.config, ratio, "o-", color=FAILURES, markersize=3, linewidth=1, label="failure ratio")
        twin.set_ylim(0, 1)
        twin.tick_params(labelright=twin is twins[-1])
        axes.set(title=f"iteration {iteration}", xlabel="configuration c")
        axes.title.set_fontsize(9)
    all_axes[0].set_ylabel("trial ratio (bars)")
    twins[-1].set_ylabel("failure ratio (line)")
    return figure


def spread(table: pd.DataFrame) -> Figure:
    """Mean and standard deviation over configurations of both ratios (Fig. 6)."""
    total = table.groupby("iteration").trials.transform("sum").clip(lower=1)
    ratios = table.assign(
        trial=table.trials / total, failure=table.failures / table.trials.where(table.trials > 0)
    )
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
        axes.set(xlabel="iteration", ylabel=f"{name} ratio, since the beginning", ylim=(0, None))
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    return figure


def evaluations(evaluation: pd.DataFrame, episodes: int, greedy: bool) -> Figure:
    """Goal ratio and return at every checkpoint, on the uniform evaluation (Fig. 7)."""
    figure = Figure((8, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(evaluation.iteration, evaluation.goal_ratio, "o-", color=GOAL, markersize=4)
    left.set(xlabel="iteration", ylabel="goal ratio", ylim=(0, 1.02))
    right.plot(evaluation.iteration, evaluation.mean_return, "o-", color=PATH, markersize=4)
    right.set(xlabel="iteration", ylabel="mean return")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.set_title(f"{episodes} {'greedy' if greedy else 'sampled'} episodes, uniform draw", fontsize=9)
    return figure


def rooms(scene: Scene, table: Configurations, trajectories: pd.DataFrame | None = None) -> Figure:
    """The map from above with its configurations and, if any, flown trajectories (Fig. 2-3)."""
    figure = Figure((6.4, 6.4), layout="constrained")
    axes = figure.subplots()
    for lower, upper in zip(scene.wall_lower, scene.wall_upper, strict=True):
        size = upper - lower
        axes.add_patch(Rectangle((lower[0], lower[1]), size[0], size[1], color="0.35", linewidth=0))
    if trajectories is not None:
        for _, path in trajectories.groupby("episode"):
            reached = path.goal.iloc[0] == 1
            axes.plot(
                path.x,
                path.y,
                color=PATH if reached else FAILURES,
                linewidth=0.9,
                alpha=0.7 if reached else 1,
            )
            if not reached:
                axes.plot(path.x.iloc[-1], path.y.iloc[-1], "x", color=FAILURES)
    _pairs(axes, table)
    low, high = scene.wall_lower[:, :2].min(axis=0), scene.wall_upper[:, :2].max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)", ylabel="y (m)", aspect="equal")
    if trajectories is not None:
        flights = trajectories.groupby("episode").goal.first()
        axes.set_title(
            f"{int(flights.sum())} of {len(flights)} flights reach their goal (× where one ends otherwise)",
            fontsize=9,
        )
    return figure


def _pairs(axes: Axes, table: Configurations) -> None:
    """Marks every place once and names the configurations that start there."""
    starts: dict[tuple[float, float], list[int]] = {}
    for row, (start, goal) in enumerate(zip(np.asarray(table.start), np.asarray(table.goal), strict=True)):
        starts.setdefault((float(start[0]), float(start[1])), []).append(row)
        starts.setdefault((float(goal[0]), float(goal[1])), [])
        axes.plot(*np.stack([start, goal]).T, color="0.6", linewidth=0.6, linestyle=":", zorder=1)
    for place, rows in starts.items():
        axes.plot(*place, "o", color=GOAL, markersize=5)
        if rows:
            name = ",".join(f"c{row}" for row in rows)
            axes.annotate(name, place, textcoords="offset points", xytext=(5, 5), fontsize=8, color=GOAL)
