"""The command line: `pecjax train`, `eval`, `figures` and `check`."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import json
import re
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Annotated

import numpy as np
import tyro

from pecjax.errors import InputError
from pecjax.experiments import devices, evaluation, presets, training
from pecjax.experiments.checkpoint import Checkpoints
from pecjax.experiments.run_directory import RunDirectory
from pecjax.world.coordinates import check_coordinates, load_coordinates
from pecjax.world.navigation import NavigationSettings
from pecjax.world.scene import load_scene


@dataclass(frozen=True)
class Train:
    """Trains a drone and writes a run folder with its figures.

    Attributes:
        preset: where the settings begin from: fast, rllib085 (the paper's own) or image (64×48) for
            ppo, apex-fast or apex-rllib085 for apex. (default: fast or apex-fast)
        algorithm: the learner: ppo or apex. (default: the preset's)
        sampler: how the next configuration is chosen: pec or uniform.
        alpha: α of PEC, 0 or more; the larger, the nearer to uniform. (default: 0.2)
        coordinates: the paper's set 1 or 2, or a file of lines 'x, y, x, y'. (default: 1)
        scene: a map and drone in MJCF. (default: the paper's six rooms)
        seed: of everything random in training. (default: 0)
        iterations: how many to train for. (default: the preset's)
        until_goal_ratio: stops once the training goal ratio has reached it in so many iterations in a
            row as patience says.
        patience: see there. (default: 5)
        num_envs: environments flown side by side. (default: the preset's)
        devices: how many share them. (default: all that divide them evenly)
        out: the run's folder. (default: a new one under runs/)
        sampled_evaluation: evaluates with drawn actions instead of the likeliest ones.
    """

    preset: str | None = None
    algorithm: str | None = None
    sampler: str | None = None
    alpha: float | None = None
    coordinates: str | None = None
    scene: str | None = None
    seed: int | None = None
    iterations: int | None = None
    until_goal_ratio: float | None = None
    patience: int | None = None
    num_envs: int | None = None
    devices: int | None = None
    out: Path | None = None
    sampled_evaluation: bool = False

    def run(self) -> None:
        """Trains, then draws."""
        settings = presets.override(
            presets.find_preset(self.preset, self.algorithm),
            num_envs=self.num_envs,
            sampler=self.sampler,
            alpha=self.alpha,
            coordinates=self.coordinates,
            scene=self.scene,
            seed=self.seed,
            iterations=self.iterations,
            until_goal_ratio=self.until_goal_ratio,
            patience=self.patience,
            greedy=False if self.sampled_evaluation else None,
        )
        folder = self.out or Path("runs") / time.strftime(f"{settings.sampler}-%Y%m%d-%H%M%S")
        summary = training.train(settings, folder, self.devices)
        _figures().draw_run(folder)
        evaluated = summary["uniform_evaluation"]
        print(
            f"{folder}: goal ratio {evaluated['goal_ratio']:.3f} over {evaluated['episodes']} "
            f"{'greedy' if evaluated['greedy'] else 'sampled'} episodes of a uniform draw, after "
            f"{summary['env_steps']:,} steps in {summary['seconds']:.0f} s "
            f"(and {summary['compile_seconds']:.0f} s of compilation)"
        )


@dataclass(frozen=True)
class Eval:
    """Evaluates a checkpoint on a uniform draw of the run's configurations.

    Attributes:
        folder: the run's folder.
        checkpoint: the iteration it was saved at. (default: the newest)
        episodes: how many to fly, spread evenly over the configurations.
        sampled: draws actions from the policy; else the likeliest is taken.
        seed: of headings and drawn actions.
        json: prints one JSON object.
    """

    folder: tyro.conf.Positional[Path]
    checkpoint: int | None = None
    episodes: int = 50
    sampled: bool = False
    seed: int = 1
    json: bool = False

    def run(self) -> None:
        """Flies and reports."""
        directory = RunDirectory(self.folder)
        settings = dataclasses.replace(
            directory.settings(),
            evaluation_episodes=self.episodes,
            evaluation_seed=self.seed,
            greedy=not self.sampled,
        )
        presets.check_settings(settings)
        num_devices = devices.choose_num_devices(None, settings.learner.shares)
        scene = load_scene(directory.scene_path, settings.resolution)
        run = training.build(settings, scene, directory.table(), num_devices)
        like = training.abstract_learner(run)
        iteration, learner = Checkpoints(self.folder).load_learner(like, self.checkpoint)
        flights = training.compile_evaluator(run, settings, learner)(learner)
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


@dataclass(frozen=True)
class Figures:
    """Draws a run's figures again, from its plain files.

    Attributes:
        folder: the run's folder.
    """

    folder: tyro.conf.Positional[Path]

    def run(self) -> None:
        """Draws and names the files."""
        for path in _figures().draw_run(self.folder):
            print(path)


@dataclass(frozen=True)
class Check:
    """Checks a map and its coordinates, and draws them.

    Attributes:
        scene: a map and drone in MJCF. (default: the paper's six rooms)
        coordinates: the paper's set 1 or 2, or a file of lines 'x, y, x, y'.
        out: where the picture goes, as .png and .svg.
    """

    scene: Path | None = None
    coordinates: str = "1"
    out: Path = Path("check")

    def run(self) -> None:
        """Checks, then draws."""
        scene = load_scene(self.scene)
        table = load_coordinates(self.coordinates)
        check_coordinates(scene, table, flight_height=NavigationSettings().flight_height)
        stem = self.out.with_suffix("") if self.out.suffix in (".png", ".svg") else self.out
        try:
            paths = _figures().save(_figures().rooms(scene, table), stem)
        except OSError as error:
            raise InputError(
                f"{self.out}: cannot be written ({error.strerror}); choose another --out"
            ) from error
        print(
            f"{len(scene.wall_names)} walls, {table.size} configurations: every one can be flown by a "
            f"drone of radius {scene.drone_radius:g} m; drawn to {' and '.join(map(str, paths))}"
        )


def _figures() -> ModuleType:
    """The module that draws; pandas and matplotlib would hold up everything else by 2 s."""
    return importlib.import_module("pecjax.experiments.figures")


Command = (
    Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Eval, tyro.conf.subcommand("eval")]
    | Annotated[Figures, tyro.conf.subcommand("figures")]
    | Annotated[Check, tyro.conf.subcommand("check")]
)


def parse(args: Sequence[str] | None = None) -> Command:
    """Reads the command line.

    Raises:
        InputError: it cannot be understood.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(Command, prog="pecjax", description=__doc__, args=args)
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        # tyro frames its complaint in a box of several lines; ours is one.
        words = re.sub(r"[^\x20-\x7e]+", " ", complaint.getvalue())
        raise InputError(" ".join(words.split())) from None


def main(args: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    devices.use_all_cores()
    devices.keep_compiled_programs()
    try:
        parse(args).run()
    except InputError as error:
        print(f"pecjax: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("pecjax: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
