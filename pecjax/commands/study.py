"""`pecjax study`."""

from __future__ import annotations

import dataclasses
import importlib
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import jax
import tyro

from pecjax.commands import settings_args
from pecjax.commands.drawing import draw
from pecjax.commands.options import Option, Rest
from pecjax.errors import DivergedError, InputError
from pecjax.studies.catalogue import find_study
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import StudySettings, read_grid
from pecjax.studies.run import run_study
from pecjax.training import presets
from pecjax.training.samplers import has_alpha, make_sampler


@dataclass(frozen=True)
class Study:
    """Trains a grid of samplers, α and seeds, paired by seed, and compares them.

    Stopped at any moment, the same command goes on where it was.

    Attributes:
        name: one of the paper's experiments: fig4 (PPO, set 1), fig8 (set 2), fig11 (α) or
            fig14 (Ape-X). (default: a grid of your own)
        scale: of a named study: smoke (seconds, to try it), laptop (our presets, for two cores) or
            paper (its iteration counts and RLlib's settings). (default: laptop)
        preset: the settings all runs share. (default: the study's; for a grid of your own, fast)
        samplers: pec, uniform, or some of your own as my.module:Class. (default: the study's, or pec
            and uniform)
        alphas: each is tried with pec. (default: the study's, or 0.2)
        coordinates: the paper's sets 1 and 2, or files. (default: the study's, or 1)
        seeds: numbers, or ranges such as 0-9. (default: the study's, or 0-4)
        iterations: of each run. (default: the study's, or the preset's where one is given)
        evaluate_every: iterations between evaluations. (default: as for the iterations)
        scene: a map and drone in MJCF. (default: the paper's six rooms)
        at_once: runs in one program. (default: as many as there are devices)
        grid: another setting to vary, and its values: ppo.learning_rate 1e-4 3e-4, or sampler.floor 0 0.1;
            may be given several times.
        out: the study's folder. (default: studies/NAME-SCALE, or studies/own)
        settings: options by their dotted paths (see `settings_args`).
    """

    name: tyro.conf.Positional[Option[str]] = None
    scale: Option[str] = None
    preset: Option[str] = None
    samplers: Option[tuple[str, ...]] = None
    alphas: Option[tuple[float, ...]] = None
    coordinates: Option[tuple[str, ...]] = None
    seeds: Option[tuple[str, ...]] = None
    iterations: Option[int] = None
    evaluate_every: Option[int] = None
    scene: Option[str] = None
    at_once: Option[int] = None
    grid: Annotated[tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction] = ()
    out: Option[Path] = None
    settings: Rest = ()

    def run(self) -> None:
        """Trains, summarizes and draws."""
        default = f"{self.name}-{self.scale or 'laptop'}" if self.name else "own"
        folder = self.out or Path("studies") / default
        trial = f"{folder}: a smoke study tries the program out; its runs are too short to learn anything"
        notice = trial if self.scale == "smoke" else None
        try:
            run_study(self._settings(folder), folder, notice)
        except DivergedError:
            if StudyDirectory(folder).has_rows():
                self._report(folder, notice)
            raise
        self._report(folder, notice)

    def _report(self, folder: Path, notice: str | None) -> None:
        report = importlib.import_module("pecjax.studies.report")
        print(report.write_report(folder))
        draw(folder)
        print(f"{folder}: results.csv, runs.csv, summary.csv, paired.csv and figures/")
        if notice:
            print(f"pecjax: {notice}", file=sys.stderr)

    def _settings(self, folder: Path) -> StudySettings:
        study = self._base()
        at_once = self.at_once
        if at_once is None and (folder / "study.json").is_file():
            at_once = StudyDirectory(folder).settings().at_once  # as it was begun
        changes = {
            "samplers": self.samplers,
            "alphas": self.alphas,
            "coordinates": self.coordinates,
            "seeds": None if self.seeds is None else read_seeds(self.seeds),
            "at_once": len(jax.devices()) if at_once is None else at_once,
        }
        run = presets.override(
            study.run, iterations=self.iterations, evaluate_every=self.evaluate_every, scene=self.scene
        )
        if any(word.startswith("--sampler.") for word in self.settings):
            raise InputError("a study tries its samplers' numbers; give --samplers and --alphas")
        run = settings_args.apply(run, self.settings, Study)
        given = {name: value for name, value in changes.items() if value is not None}
        settings = dataclasses.replace(study, run=run, **given)
        if self.grid:
            grid = tuple(read_grid(run, settings.samplers, words) for words in self.grid)
            settings = dataclasses.replace(settings, grid=grid)
        if self.alphas and not any(has_alpha(make_sampler(name)) for name in settings.samplers):
            raise InputError(f"samplers: {', '.join(settings.samplers)} has no alpha; leave out --alphas")
        return settings

    def _base(self) -> StudySettings:
        """The study to begin from."""
        preset = None if self.preset is None else presets.find_preset(self.preset)
        if self.name is None:
            if self.scale is not None:
                raise InputError("scale is of the paper's studies; name one, such as fig4, or leave it out")
            return StudySettings("own", preset or presets.PRESETS["fast"])
        study = find_study(self.name, self.scale or "laptop")
        if preset and preset.algorithm != study.run.algorithm:
            raise InputError(
                f"preset {self.preset} is of {preset.algorithm} and {self.name} of {study.run.algorithm}; "
                "choose another preset, or name no study"
            )
        return dataclasses.replace(study, run=preset or study.run)


def read_seeds(words: tuple[str, ...]) -> tuple[int, ...]:
    """Seeds from words such as '3' and '0-9'.

    Raises:
        InputError: a word is neither.
    """
    seeds: list[int] = []
    for word in words:
        found = re.fullmatch(r"(\d{1,10})(?:-(\d{1,10}))?", word)
        if not found:
            raise InputError(f"seeds: '{word}' is neither a number nor a range such as 0-9")
        first, last = int(found[1]), int(found[2] or found[1])
        if not first <= last < first + 10_000:
            raise InputError(f"seeds: '{word}' must rise, by less than 10,000")
        seeds.extend(range(first, last + 1))
    return tuple(seeds)
