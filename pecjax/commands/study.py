"""`pecjax study`."""

from __future__ import annotations

import dataclasses
import importlib
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import jax
import tyro

from pecjax.commands import settings_args
from pecjax.commands.drawing import draw, draw_benchmark
from pecjax.commands.options import Floats, Option, Rest, Strings
from pecjax.errors import DivergedError, InputError
from pecjax.studies import benchmark
from pecjax.studies.catalogue import OWN, find_study
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import StudySettings, read_grid
from pecjax.studies.run import run_study
from pecjax.training.kinds import has_alpha, kind_name
from pecjax.training.presets import PRESETS, find_preset
from pecjax.training.settings import RunSettings, override

REPORT, LAPTOP = "report", "laptop"
# Of a study that is none of the paper's.
OWN_GRID = (("sampler", ("pec", "uniform")), ("sampler.alpha", (0.2,)))


@dataclass(frozen=True)
class Study:
    """Trains a grid of samplers, α and seeds, paired by seed, and compares them.

    Stopped at any moment, the same command resumes it where it was.

    Attributes:
        name: one of the paper's experiments: fig4 (PPO, set 1), fig8 (set 2), fig11 (α) or
            fig14 (Ape-X); samplers, the benchmark of docs/benchmark.md, or one space of it, as
            samplers-rooms-pairs; or report, which makes the tables and figures of the study or the benchmark
            in the folder --out again.
            (default: a grid of your own)
        scale: of a named study: smoke (seconds, to try it), laptop (our presets, for two cores) or
            paper (its iteration counts and RLlib's settings); of the benchmark smoke, laptop (three seeds),
            full or screening. (default: laptop)
        preset: the settings all runs share. (default: the study's; for a grid of your own, fast)
        samplers: pec, uniform, table_top or others of docs/samplers.md, or your own as my.module:Class.
            (default: the study's, or pec and uniform)
        alphas: each is tried with the samplers that have one. (default: the study's, or 0.2)
        coordinates: the paper's sets 1 and 2, or files. (default: the study's, or what the maps mark, else 1)
        seeds: numbers, or ranges such as 0-9. (default: the study's, or 0-4)
        iterations: of each run. (default: the study's, or the preset's where one is given)
        evaluate_every: iterations between evaluations. (default: as for the iterations)
        task: what is learned: rooms, or one of your own as my.module:Class. (default: rooms)
        scene: maps as MJCF or text plans (.txt), files or folders. (default: the paper's six rooms)
        parallel_runs: runs in one program. (default: as many as there are devices)
        grid: another setting to vary, and its values: agent.learning_rate 1e-4 3e-4, or sampler.half_life 3
            10; may be given several times.
        out: the study's folder; the benchmark's, which has one for each space. (default:
            studies/NAME-SCALE, or studies/own; of the benchmark studies/samplers-SCALE)
        settings: options by their dotted paths (see `settings_args`).
    """

    name: tyro.conf.Positional[Option[str]] = None
    scale: Option[str] = None
    preset: Option[str] = None
    samplers: Strings = None
    alphas: Floats = None
    coordinates: Strings = None
    seeds: Strings = None
    iterations: Option[int] = None
    evaluate_every: Option[int] = None
    task: Option[str] = None
    scene: Strings = None
    parallel_runs: Option[int] = None
    grid: Annotated[tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction] = ()
    out: Option[Path] = None
    settings: Rest = ()

    def run(self) -> None:
        """Trains, summarizes and draws."""
        scale = self.scale or LAPTOP
        members = benchmark.members(str(self.name), scale)
        of_all = benchmark.BENCHMARK if members or self.name == REPORT else self.name
        folder = self.out or Path("studies") / (f"{of_all}-{scale}" if of_all else OWN)
        if self.name == REPORT:
            self._rebuild_report(folder)
        elif members:
            self._run_benchmark(members, folder)
        else:
            self._run_study(folder)

    def _rebuild_report(self, folder: Path) -> None:
        """Makes tables and figures again, of a study from its batches, of the benchmark from results."""
        if (folder / "study.json").is_file():
            for line in StudyDirectory(folder).rebuild_tables():
                print(line, file=sys.stderr)
            self._report(folder, None)
        else:
            print(_benchmark_report(folder))

    def _run_benchmark(self, members: Sequence[str], folder: Path) -> None:
        """The benchmark's studies, one after another, and their report."""
        diverged: list[str] = []
        for name in members:
            cell = folder / benchmark.cell(name)
            try:
                run_study(dataclasses.replace(self, name=name)._settings(cell), cell, self._notice(cell))
            except DivergedError as error:
                diverged.append(str(error))
            importlib.import_module("pecjax.studies.shares").write_shares(cell)
        cells = (StudyDirectory(folder / benchmark.cell(name)) for name in members)
        if any(cell.has_rows() for cell in cells):
            print(_benchmark_report(folder))
        if diverged:
            raise DivergedError("; ".join(diverged))

    def _run_study(self, folder: Path) -> None:
        notice = self._notice(folder)
        try:
            run_study(self._settings(folder), folder, notice)
        except DivergedError:
            if StudyDirectory(folder).has_rows():
                self._report(folder, notice)
            raise
        self._report(folder, notice)

    def _notice(self, folder: Path) -> str | None:
        trial = f"{folder}: a smoke study tries the program out; its runs are too short to learn anything"
        return trial if self.scale == "smoke" else None

    def _report(self, folder: Path, notice: str | None) -> None:
        report = importlib.import_module("pecjax.studies.report")
        print(report.write_report(folder))
        draw(folder)
        print(f"{folder}: results.csv, runs.csv, summary.csv, paired.csv, report.md and figures/")
        if notice:
            print(f"pecjax: {notice}", file=sys.stderr)

    def _settings(self, folder: Path) -> StudySettings:
        study = self._base()
        parallel_runs = self.parallel_runs
        if parallel_runs is None and (folder / "study.json").is_file():
            parallel_runs = StudyDirectory(folder).settings().parallel_runs  # as it was started with
        if any(word.startswith("--sampler.") for word in self.settings):
            raise InputError("a study tries its samplers' numbers; give --samplers, --alphas and --grid")
        run = override(
            study.run,
            task=self.task,
            iterations=self.iterations,
            evaluate_every=self.evaluate_every,
            scene=self.scene,
        )
        run = settings_args.apply(run, self.settings, Study)
        own = self.grid or any(given is not None for given in (self.samplers, self.alphas, self.coordinates))
        return dataclasses.replace(
            study,
            run=run,
            grid=self._grid(study, run),
            conditions=((),) if own else study.conditions,
            seeds=study.seeds if self.seeds is None else read_seeds(self.seeds),
            parallel_runs=len(jax.devices()) if parallel_runs is None else parallel_runs,
        )

    def _grid(self, study: StudySettings, run: RunSettings) -> tuple[tuple[str, tuple], ...]:
        """What the study varies: its own grid with the changes, then what else is given."""
        grid = dict(study.grid)
        if not hasattr(run.task, "table"):
            grid.pop("task.table", None)
        given = {"task.table": self.coordinates, "sampler": self.samplers, "sampler.alpha": self.alphas}
        for path, values in given.items():
            if values is not None:
                grid[path] = tuple(values)
        names = grid.get("sampler", (kind_name(run.sampler),))
        samplers = tuple(kind_name(override(run, sampler=str(name)).sampler) for name in names)
        if "sampler" in grid:
            grid["sampler"] = samplers
        if not any(has_alpha(override(run, sampler=name).sampler) for name in samplers):
            if self.alphas is not None:
                raise InputError(f"samplers: {', '.join(samplers)} has no alpha; leave out --alphas")
            grid.pop("sampler.alpha", None)
        further = [read_grid(run, samplers, words) for words in self.grid]
        paths = [path for path, _ in further]
        twice = [path for path in paths if paths.count(path) > 1 or given.get(path) is not None]
        if twice:
            raise InputError(f"grid: {twice[0]} is given twice; give all its values at once")
        return tuple((grid | dict(further)).items())

    def _base(self) -> StudySettings:
        """The study to start from."""
        preset = None if self.preset is None else find_preset(self.preset)
        if self.name is None:
            if self.scale is not None:
                raise InputError("scale is of named studies; name one, such as fig4, or leave it out")
            return StudySettings(OWN, preset or PRESETS["fast"], OWN_GRID)
        study = find_study(self.name, self.scale or LAPTOP)
        if preset and self.name in benchmark.STUDIES:
            raise InputError(f"preset: {self.name} has settings of its own; leave out --preset")
        agents = [kind_name(run.agent) for run in (preset or study.run, study.run)]
        if len(set(agents)) > 1:
            raise InputError(
                f"preset {self.preset} is of {agents[0]} and {self.name} of {agents[1]}; "
                "choose another preset, or name no study"
            )
        return dataclasses.replace(study, run=preset or study.run)


def _benchmark_report(folder: Path) -> str:
    text = importlib.import_module("pecjax.studies.benchmark_report").write_benchmark_report(folder)
    draw_benchmark(folder)
    return f"{text}\n{folder}: runs.csv, comparisons.csv, report.md and figures/"


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
