"""`pecjax eval`."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from pecjax.commands.options import Option
from pecjax.envs.rooms.config import Configurations
from pecjax.training.evaluation import success_by_config
from pecjax.training.load import open_run
from pecjax.training.program import compile_evaluator
from pecjax.training.settings import EvaluationSettings, check_settings

MOST_LINES = 60  # of configurations


@dataclass(frozen=True)
class Eval:
    """Evaluates a checkpoint on a uniform draw of the run's configurations.

    The evaluations in the run's own tables are of another seed and number (2022, and 200 in most presets):
    they differ by chance, unless these are given here with --seed and --episodes.

    Attributes:
        folder: the run's folder.
        checkpoint: the iteration it was saved at. (default: the newest)
        episodes: how many, spread evenly over the configurations.
        sampled: draws actions from the policy; else the most likely one is taken.
        seed: of headings and drawn actions.
        json: prints one JSON object.
    """

    folder: tyro.conf.Positional[Path]
    checkpoint: Option[int] = None
    episodes: int = 50
    sampled: bool = False
    seed: int = 1
    json: bool = False

    def run(self) -> None:
        """Runs the episodes and reports."""
        trained = open_run(self.folder, self.checkpoint)
        about = EvaluationSettings(episodes=self.episodes, seed=self.seed, greedy=not self.sampled)
        settings = dataclasses.replace(trained.settings, evaluation=about)
        check_settings(settings)
        run = trained.run
        result = compile_evaluator(run, settings, trained.learner)(trained.learner, run.world)
        ratios = success_by_config(result.config_id, result.success, run.num_configs)
        report = {
            "goal_ratio": float(result.success.mean()),
            "mean_return": float(result.returns.mean()),
            "episodes": self.episodes,
            "per_configuration": [None if np.isnan(r) else float(r) for r in ratios],
            "greedy": about.greedy,
            "seed": self.seed,
            "checkpoint": trained.iteration,
        }
        if self.json:
            print(json.dumps(report))
            return
        print(
            f"checkpoint {trained.iteration}: goal ratio {report['goal_ratio']:.4f}, mean return "
            f"{report['mean_return']:.1f} over {self.episodes} "
            f"{'greedy' if about.greedy else 'sampled'} episodes of a uniform draw"
        )
        order = np.arange(run.num_configs)
        if len(order) > MOST_LINES:
            order = np.argsort(ratios)[:MOST_LINES]  # what was not flown comes last
            print(f"the {MOST_LINES} lowest of {run.num_configs} configurations:")
        for config in order.tolist():
            line = f"  c{config:<3} {describe(run.world.table, config)}"
            print(f"{line:34} {'not flown' if np.isnan(ratios[config]) else f'{ratios[config]:.3f}'}")


def describe(table: Any, row: int) -> str:
    """A configuration in words: where it leads from and to, or its numbers."""
    one = jax.tree.map(lambda leaf: np.asarray(leaf)[row], table)
    if isinstance(one, Configurations):
        (x, y), (goal_x, goal_y) = one.start, one.goal
        where = f"({x:g}, {y:g}) -> ({goal_x:g}, {goal_y:g})"
        return where + (f" in map {one.map_id}" if np.any(np.asarray(table.map_id)) else "")
    return " ".join(f"{value:g}" for leaf in jax.tree.leaves(one) for value in np.ravel(leaf))
