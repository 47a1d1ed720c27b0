"""`pecjax eval`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pecjax.commands.drawing import draw_evaluation
from pecjax.commands.flown import Flown
from pecjax.commands.options import Option
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.spaces.features import features
from pecjax.envs.task import num_configs
from pecjax.training.eval_report import Report, make_report
from pecjax.training.run_episodes import success_by_config

MOST_LINES = 60  # of configurations; of more than that,
LOWEST = 20  # so many are listed


@dataclass(frozen=True)
class Eval(Flown):
    """Evaluates a checkpoint on a uniform draw of configurations: the run's own, or others.

    A run that was trained in a space is evaluated in the part of it that was held out. The evaluations in
    the run's own tables are of another seed and number (2022, and 200 in most presets): they differ by
    chance, unless these are given here with --seed and --episodes.

    Attributes:
        episodes: how many, spread evenly over the configurations.
        seed: of headings and drawn actions.
        json: prints one JSON object.
        out: where a figure of the report goes, as .pdf and .png. (default: none is drawn)
    """

    episodes: int = 50
    seed: int = 1
    json: bool = False
    out: Option[Path] = None

    def run(self) -> None:
        """Runs the episodes and reports."""
        trained, result = self.fly(self.episodes, self.seed)
        run, where = trained.run, trained.run.eval_set
        ratios = success_by_config(result.config_id, result.success, num_configs(where.table))
        is_rooms = isinstance(where.table, Configurations)
        report = make_report(result, where, features(where.table, where.shortest) if is_rooms else {})
        if self.out is not None:
            draw_evaluation(report, self.out)
        if self.json:
            whole = {
                "goal_ratio": float(result.success.mean()),
                "mean_return": float(result.returns.mean()),
                "episodes": self.episodes,
                "per_configuration": [None if np.isnan(r) else float(r) for r in ratios],
                "greedy": not self.sampled,
                "seed": self.seed,
                "checkpoint": trained.iteration,
                "report": report,
            }
            print(json.dumps(whole))
            return
        print(
            f"checkpoint {trained.iteration}: goal ratio {report['all']['goal_ratio']:.4f}, mean return "
            f"{report['all']['mean_return']:.1f} over {self.episodes} "
            f"{'sampled' if self.sampled else 'greedy'} episodes of a uniform draw"
        )
        period = run.task.settings.control_period if is_rooms else None
        _print_report(report, period)
        _print_configurations(where.table, ratios)


def _print_report(report: Report, period: float | None) -> None:
    """A line for all episodes, each group and each bin."""
    heads = f"{'episodes':>8} {'goal ratio':>8} [95 %]         {'SPL':>6} {'CVaR':>6} {'time':>7}"
    print(f"  {'':32} {heads} {'hit':>6} {'late':>6}")
    _print_line("all", report["all"], period)
    for name, figures in report["groups"].items():
        _print_line(name, figures, period)
    for name, bins in report["features"].items():
        for part in bins:
            _print_line(f"{name} {part['low']:.3g} to {part['high']:.3g}", part, period)


def _print_line(name: str, figures: dict[str, Any], period: float | None) -> None:
    if not figures["episodes"]:
        print(f"  {name:32} {0:8}")
        return
    low, high = figures["interval"]
    steps = figures["steps_to_goal"]
    time = "" if steps is None else f"{steps * period:.1f} s" if period else f"{steps:.0f}"

    def number(key: str) -> str:
        return "" if figures.get(key) is None else f"{figures[key]:.3f}"

    print(
        f"  {name:32} {figures['episodes']:8} {figures['goal_ratio']:8.3f} [{low:.3f}, {high:.3f}] "
        f"{number('spl'):>6} {number('unbiased_cvar'):>6} {time:>7} {number('collision'):>6} "
        f"{number('timeout'):>6}"
    )


def _print_configurations(table: Any, ratios: np.ndarray) -> None:
    """A line for each configuration; of many, for the lowest that were flown."""
    order = np.arange(len(ratios))
    if len(order) > MOST_LINES:
        flown = np.flatnonzero(~np.isnan(ratios))
        order = flown[np.argsort(ratios[flown], kind="stable")][:LOWEST]
        print(f"the {len(order)} lowest of {len(flown)} configurations that were flown, of {len(ratios)}:")
    for config in order.tolist():
        line = f"  c{config:<3} {describe(table, config)}"
        print(f"{line:34} {'not flown' if np.isnan(ratios[config]) else f'{ratios[config]:.3f}'}")


def describe(table: Any, row: int) -> str:
    """A configuration in words: where it leads from and to, or its numbers."""
    one = jax.tree.map(lambda leaf: np.asarray(leaf)[row], table)
    if isinstance(one, Configurations):
        (x, y), (goal_x, goal_y) = one.start, one.goal
        where = f"({x:g}, {y:g}) -> ({goal_x:g}, {goal_y:g})"
        return where + (f" in map {one.map_id}" if np.any(np.asarray(table.map_id)) else "")
    return " ".join(f"{value:g}" for leaf in jax.tree.leaves(one) for value in np.ravel(leaf))
