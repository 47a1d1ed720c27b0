"""A study: the host's loop over the slices of a grid."""

from __future__ import annotations

import dataclasses
import itertools
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pecjax.agents.agent import Metrics
from pecjax.errors import DivergedError, StoppedError
from pecjax.training import rows as tables
from pecjax.training.build import load_world
from pecjax.training.evaluation import EvalResult
from pecjax.studies.grid import RunSpec, StudySettings, fixed, numbers
from pecjax.runtime.signals import Interruption
from pecjax.studies.statistics import cvar
from pecjax.storage.files import Row, exact_text, writing
from pecjax.training.progress import Progress
from pecjax.studies.directory import StudyDirectory, Tables, World
from pecjax.training.program import Program, make_program
from pecjax.envs.rooms.notices import world_notices


def run_study(settings: StudySettings, folder: Path, notice: str | None = None) -> None:
    """Makes every run of a study that its folder does not hold yet.

    A slice is written when it is whole, and so a study that is stopped goes on with the slice it
    was at; its tables end as if it had never stopped. A run that diverges is left out of the tables
    and not repeated; all others are made.

    Args:
        notice: a line to print first.

    Raises:
        InputError: anything the user can put right, such as a folder of another study.
        StoppedError: a signal asked for it.
        DivergedError: some runs diverged; all that can be made is there.
    """
    settings.check()
    worlds = {
        name: load_world(dataclasses.replace(settings.run, coordinates=name)) for name in settings.coordinates
    }
    directory = StudyDirectory(folder)
    runs = sum(map(len, settings.slices()))
    with (
        directory.open(settings, worlds, len(jax.devices())),
        writing(folder, "the same command goes on once it can"),
        Progress(runs * settings.run.iterations) as progress,
        Interruption() as interruption,
    ):
        if notice:
            progress.say(notice)
        _make_slices(settings, worlds, directory, progress, interruption)
    diverged = directory.diverged(len(settings.slices()))
    if diverged:
        raise DivergedError(
            f"{folder}: {len(diverged)} of {runs} runs diverged and are not in its tables; "
            f"{'; '.join(diverged[:3])}{'; …' if len(diverged) > 3 else ''}"
        )


def _make_slices(
    settings: StudySettings,
    worlds: dict[str, World],
    directory: StudyDirectory,
    progress: Progress,
    interruption: Interruption,
) -> None:
    slices = settings.slices()
    notices = [world_notices(scene, table) for _, scene, table in worlds.values()]
    for line in dict.fromkeys(itertools.chain(*notices)):
        progress.say(f"notice: {line}")
    for line in directory.verify(len(slices)):
        progress.say(line)
    programs: dict[tuple, Program] = {}
    for number, members in enumerate(slices):
        if directory.holds(number):
            progress.skip(len(members) * settings.run.iterations)
            continue
        _stop_if_asked(interruption)
        first = members[0]
        key = (first.coordinates, first.sampler, fixed(first.values), len(members))
        if key not in programs:
            _, scene, table = worlds[first.coordinates]
            programs[key] = make_program(settings.settings_of(first), scene, table, len(members))
        finished, diverged = _train(settings, members, programs[key], progress, interruption)
        directory.write_slice(number, finished, diverged)
        directory.gather(len(slices))
    directory.gather(len(slices))


def _train(
    settings: StudySettings,
    members: tuple[RunSpec, ...],
    program: Program,
    progress: Progress,
    interruption: Interruption,
) -> tuple[Tables, list[str]]:
    """Trains the runs of one slice to their end: their rows, and in words those that diverged."""
    run = settings.run
    seeds = np.array([member.seed for member in members], np.int32)
    found = [numbers(member) for member in members]
    varied = {name: np.array([of_run[name] for of_run in found], np.float32) for name in found[0]}
    rows = [_Rows(settings, member, program.steps_per_iteration) for member in members]
    states = program.init(seeds, varied)
    done, diverged = 0, []
    while done < run.iterations:
        begun = time.perf_counter()
        number = min(run.evaluate_every, run.iterations - done)
        # Only enqueued: the devices do not wait for the host between iterations.
        enqueued = []
        for _ in range(number):
            states, metrics = program.iterate(states)
            enqueued.append(metrics)
        flights = program.evaluate(states.learner)
        fetched, flights = jax.device_get((enqueued, flights))
        for place, of_run in enumerate(rows):
            for iteration, metrics in enumerate(fetched, done + 1):
                of_run.add_metrics(iteration, _of_run(metrics, place))
            of_run.add_evaluation(done + number, _of_run(flights, place))
            if of_run.diverged and of_run.diverged not in diverged:
                diverged.append(of_run.diverged)
                progress.say(f"{of_run.diverged}; the other runs continue")
        done += number
        steps = len(members) * number * program.steps_per_iteration
        rate = steps / (time.perf_counter() - begun)
        progress.advance(
            len(members) * number,
            f"goal ratio {flights.goal.mean():.3f}, {rate:,.0f} steps/s with evaluation",
        )
        if len(diverged) == len(rows):
            progress.skip(len(members) * (run.iterations - done))
            break
        if done < run.iterations:  # a slice that is whole is kept first
            _stop_if_asked(interruption)
    whole = [of_run.tables for of_run in rows if not of_run.diverged]
    return {name: [row for one in whole for row in one[name]] for name in StudyDirectory.TABLES}, diverged


def _stop_if_asked(interruption: Interruption) -> None:
    if interruption.asked:
        raise StoppedError(
            "stopped; the same command keeps what is finished and begins the other runs again",
            interruption.asked,
        )


def _of_run(tree: Any, place: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[place], tree)


class _Rows:
    """The rows of one run, as they come."""

    def __init__(self, settings: StudySettings, member: RunSpec, batch: int) -> None:
        named: Row = {"study": settings.name, **member._asdict(), **dict(member.values)}
        del named["values"]
        self._run = ", ".join(f"{name} {value}" for name, value in named.items() if value is not None)
        exact = {n: exact_text(value) if isinstance(value, float) else value for n, value in named.items()}
        self._head: Row = exact | {path: exact.get(path) for path, _ in settings.grid}
        self._batch = batch
        self._counts: Any = 0
        self._since_evaluation: list[float] = []
        self.tables: Tables = {name: [] for name in StudyDirectory.TABLES}
        self.diverged = ""  # which run, when and where, once it has

    def add_metrics(self, iteration: int, metrics: Metrics) -> None:
        if metrics.non_finite and not self.diverged:
            names = ", ".join(metrics.non_finite)
            self.diverged = f"{self._run}: at iteration {iteration} not finite: {names}"
        row = tables.metrics_row(iteration, self._batch, 0.0, metrics)
        kept = ("iteration", "env_steps", "goal_ratio", "episodes", "mean_return")
        self.tables["metrics"].append(self._head | {name: row[name] for name in kept})
        self._counts = self._counts + metrics.counts
        self._since_evaluation.append(row["goal_ratio"])

    def add_evaluation(self, iteration: int, flights: EvalResult) -> None:
        num_configs = self._counts.shape[1]
        row = tables.evaluation_row(iteration, iteration * self._batch, flights, num_configs)
        ratios = np.array([row[f"c{config}"] for config in range(num_configs)])
        ended = [ratio for ratio in self._since_evaluation if not np.isnan(ratio)]
        self._since_evaluation.clear()
        measures = {
            "goal_ratio": row.pop("goal_ratio"),
            "training_goal_ratio": float(np.mean(ended)) if ended else float("nan"),
            "cvar": float(cvar(ratios)),
        }
        steps = {"iteration": row.pop("iteration"), "env_steps": row.pop("env_steps")}
        self.tables["results"].append(self._head | steps | measures | row)
        for config, (trials, failures) in enumerate(self._counts.T):
            counts = {"config": config, "trials": trials, "failures": failures}
            self.tables["configurations"].append(self._head | {"iteration": iteration} | counts)
