"""`pecjax eval`."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from pecjax.commands.options import Option
from pecjax.training import build as assembly, evaluation, load as trained, presets
from pecjax.training.run_directory import RunDirectory


@dataclass(frozen=True)
class Eval:
    """Evaluates a checkpoint on a uniform draw of the run's configurations.

    The evaluations in the run's own tables are of another seed and number (2022, and 200 in most presets):
    they differ by chance, unless these are given here with --seed and --episodes.

    Attributes:
        folder: the run's folder.
        checkpoint: the iteration it was saved at. (default: the newest)
        episodes: how many to fly, spread evenly over the configurations.
        sampled: draws actions from the policy; else the likeliest is taken.
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
        """Flies and reports."""
        settings = dataclasses.replace(
            RunDirectory(self.folder).settings(),
            evaluation_episodes=self.episodes,
            evaluation_seed=self.seed,
            greedy=not self.sampled,
        )
        presets.check_settings(settings)
        _, run, iteration, learner = trained.open_run(self.folder, self.checkpoint)
        flights = assembly.compile_evaluator(run, settings, learner)(learner)
        ratios = evaluation.goal_ratios(flights, run.table.size)
        report = {
            "goal_ratio": float(flights.goal.mean()),
            "mean_return": float(flights.returns.mean()),
            "episodes": self.episodes,
            "per_configuration": [None if np.isnan(r) else float(r) for r in ratios],
            "greedy": settings.greedy,
            "seed": self.seed,
            "checkpoint": iteration,
        }
        if self.json:
            print(json.dumps(report))
            return
        print(
            f"checkpoint {iteration}: goal ratio {report['goal_ratio']:.4f}, mean return "
            f"{report['mean_return']:.1f} over {self.episodes} "
            f"{'greedy' if settings.greedy else 'sampled'} episodes of a uniform draw"
        )
        for config, ratio in enumerate(report["per_configuration"]):
            start, goal = run.table.start[config], run.table.goal[config]
            line = f"  c{config:<3} ({start[0]:g}, {start[1]:g}) -> ({goal[0]:g}, {goal[1]:g})"
            print(f"{line:34} {'not flown' if ratio is None else f'{ratio:.3f}'}")
