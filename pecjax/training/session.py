"""Sessions: a training in one process, and where it starts or resumes."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from pecjax.errors import InputError
from pecjax.runtime.distributed import primary_only
from pecjax.training.build import Run, abstract_state
from pecjax.training.checkpoint import Checkpoints, ResumeState
from pecjax.training.loop import Clock, Position, is_counted, is_evaluated, streak
from pecjax.training.program import Iterate, compile_iteration, start
from pecjax.training.rows import RECORDING_ARRAYS
from pecjax.training.run_directory import RunDirectory
from pecjax.training.settings import RunSettings
from pecjax.training.sinks import Progress


class Session(NamedTuple):
    """A training from its start, or from where it resumes, to its end or a stop."""

    settings: RunSettings
    run: Run
    directory: RunDirectory
    progress: Progress
    clock: Clock


def started(session: Session) -> tuple[Position, Iterate]:
    """The first state, and the compiled iteration."""
    with session.clock.compiling():
        state, iterate = start(session.run, session.settings.seed)
    return Position(state), iterate


def resumed(session: Session) -> tuple[Position, Iterate]:
    """The newest state to resume from, to which the tables are rolled back, and the compiled iteration.

    Raises:
        InputError: there is none, or the run is at its end.
    """
    settings, run, directory, progress, clock = session
    folder, stop = directory.folder, settings.stop
    checkpoints = Checkpoints(folder, directory.identity())
    there, warnings = checkpoints.load_state(ResumeState.make(abstract_state(run), 0, 0.0))
    for line in warnings:
        progress.say(line)
    done = int(there.iteration)
    if done >= stop.iterations:
        raise InputError(f"{folder}: already finished at iteration {done}; give a greater --iterations")
    patience_count = 0
    if stop.until_goal_ratio is not None:  # it may be another than before: what was counted is stale
        ratios = directory.column("metrics.csv", "goal_ratio", lambda row: row <= done)
        patience_count = streak(ratios, stop)
    if patience_count >= stop.patience:
        raise InputError(
            f"{folder}: already finished at iteration {done}: the last {patience_count} iterations reached a "
            f"goal ratio of {stop.until_goal_ratio:g}; give a higher --until-goal-ratio or more --patience"
        )
    _roll_back(session, done)
    directory.record(settings_as_started(session), run.mesh.devices.size, from_iteration=done)
    checkpoints.forget_after(done, settings.evaluation.every)
    progress.say(f"resumes after iteration {done}")
    progress.skip(done)
    clock.spent_before = float(there.seconds)
    with clock.compiling():
        return Position(there.state, done, patience_count), compile_iteration(run)


def settings_as_started(session: Session) -> RunSettings:
    """The session's settings with the names of the task's files as they were given."""
    return dataclasses.replace(session.settings, task=session.directory.settings().task)


@primary_only  # another process could look for the file when it is gone
def _remove_recording(directory: RunDirectory, done: int) -> None:
    """Only the last evaluation of a run keeps its recording."""
    if done in directory.iterations("episodes"):
        kept = directory.arrays("episodes", done)
        directory.write_arrays("episodes", done, {n: kept[n] for n in kept if n not in RECORDING_ARRAYS})


def _roll_back(session: Session, done: int) -> None:
    """Removes what a run of which so many iterations are done would not have."""
    settings, directory, progress = session.settings, session.directory, session.progress
    _remove_recording(directory, done)
    directory.remove("summary.json")
    evaluated, counted = (
        lambda row, due=due: row <= done and due(settings, row) for due in (is_evaluated, is_counted)
    )
    for name, keep in (("metrics.csv", lambda row: row <= done), ("evaluation.csv", evaluated)):
        before = (directory.folder / name).exists()
        directory.roll_back(name, keep)
        if before and not (directory.folder / name).exists():
            progress.say(
                f"{directory.folder / name}: had no whole first line; begins again after iteration {done}"
            )
    directory.remove_arrays("episodes", evaluated)
    directory.remove_arrays("configurations", counted)
