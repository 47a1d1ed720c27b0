"""A study: every run of a grid, batch by batch."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax

from pecjax.envs.task import Task, TaskSettings, World, num_configs
from pecjax.errors import DivergedError, StoppedError
from pecjax.runtime.signals import Interruption
from pecjax.storage.files import writing
from pecjax.studies.collect import Collected
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import RunSpec, StudySettings, fixed
from pecjax.training.loop import Hooks, Position, run_loop
from pecjax.training.program import StudyProgram, several_runs
from pecjax.training.sinks import Progress, Sinks

Worlds = dict[TaskSettings, tuple[Task, World]]


def run_study(settings: StudySettings, folder: Path, notice: str | None = None) -> None:
    """Makes every run of a study that its folder does not hold yet.

    A batch is written when it is whole, and so a study that is stopped resumes with the batch it
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
    batches = settings.batches()
    tasks = dict.fromkeys(settings.settings_of(spec).task for specs in batches for spec in specs)
    made = {task: task.make() for task in tasks}
    settings.check_samplers({task: num_configs(world.table) for task, (_, world) in made.items()})
    worlds = {about: (task, about.for_training(world)) for about, (task, world) in made.items()}
    directory = StudyDirectory(folder)
    runs = sum(map(len, batches))
    with (
        directory.open(settings, [*worlds], len(jax.devices())),
        writing(folder, "the same command resumes once it can"),
        Progress(runs * settings.run.stop.iterations) as progress,
        Interruption() as interruption,
    ):
        if notice:
            progress.say(notice)
        for line in dict.fromkeys(line for task, world in worlds.items() for line in task.notices(*world)):
            progress.say(f"notice: {line}")
        for line in directory.verify(len(batches)):
            progress.say(line)
        _make_batches(settings, worlds, directory, progress, interruption)
    diverged = directory.diverged(len(batches))
    if diverged:
        raise DivergedError(
            f"{folder}: {len(diverged)} of {runs} runs diverged and are not in its tables; "
            f"{'; '.join(diverged[:3])}{'; …' if len(diverged) > 3 else ''}"
        )


def _make_batches(
    settings: StudySettings,
    worlds: Worlds,
    directory: StudyDirectory,
    progress: Progress,
    interruption: Interruption,
) -> None:
    batches = settings.batches()
    programs: dict[tuple, StudyProgram] = {}
    for number, specs in enumerate(batches):
        if directory.holds(number):
            progress.skip(len(specs) * settings.run.stop.iterations)
            continue
        _stop_if_asked(interruption)
        run = settings.settings_of(specs[0])
        key = fixed(specs[0].values)
        if key not in programs:  # with as many places in the last batch, so that it rounds as the others do
            programs[key] = several_runs(run, *worlds[run.task], settings.parallel_runs)
        collected = _train(settings, specs, programs[key], progress, interruption)
        directory.write_batch(number, collected)
        directory.merge_tables(len(batches))
    directory.merge_tables(len(batches))


def _train(
    settings: StudySettings,
    specs: tuple[RunSpec, ...],
    program: StudyProgram,
    progress: Progress,
    interruption: Interruption,
) -> Collected:
    """Trains the runs of one batch to their end; what they leave, without those that diverged."""
    run = settings.settings_of(specs[0])
    # A study looks at its configurations when it evaluates, and the devices never wait for the host.
    run = dataclasses.replace(run, configurations_every=run.evaluation.every)
    heads = [settings.row(spec) for spec in specs]
    collected = Collected(heads, program.elsewhere)

    def diverged(which: int, iteration: int, names: list[str]) -> None:
        progress.say(f"{collected.diverge(which, iteration, names)}; the other runs continue")

    hooks = Hooks(diverged, asked=lambda: bool(interruption.asked), lookahead=run.evaluation.every)
    state = program.init([spec.seed for spec in specs], settings.numbers(specs))
    with Sinks([collected, progress], collected.names, 0) as sinks:
        ending = run_loop(program.program._replace(num_runs=len(specs)), Position(state), run, sinks, hooks)
    if not ending.finished:
        if len(collected.diverged) < len(specs):
            _stop_if_asked(interruption)  # a batch that is whole is kept first
        progress.skip(len(specs) * (run.stop.iterations - ending.position.iteration))
    return collected


def _stop_if_asked(interruption: Interruption) -> None:
    if interruption.asked:
        raise StoppedError(
            "stopped; the same command keeps what is finished and begins the other runs again",
            interruption.asked,
        )
