"""Training: a run from scratch, or resumed where it was stopped."""

from __future__ import annotations

import dataclasses
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax

from pecjax.errors import DivergedError, InputError, StoppedError
from pecjax.runtime.devices import advice_on_idle_devices, choose_num_devices
from pecjax.runtime.distributed import ending_together, greatest, synchronized
from pecjax.runtime.signals import Interruption
from pecjax.storage.files import alone, check_free, writing
from pecjax.training.build import Run, abstract_state, build
from pecjax.training.checkpoint import Checkpoints, ResumeState
from pecjax.training.loop import (
    Clock,
    Ending,
    Hooks,
    Position,
    is_counted,
    is_evaluated,
    run_loop,
    streak,
)
from pecjax.training.program import Iterate, compile_iteration, one_run, start
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_files import RunFiles
from pecjax.training.settings import RunSettings, check_settings
from pecjax.training.sinks import Progress, Sink, Sinks


class Session(NamedTuple):
    """A training in one process, from its start or from where it goes on, to its end or a stop."""

    settings: RunSettings
    run: Run
    directory: RunDirectory
    progress: Progress
    clock: Clock


def train(
    settings: RunSettings, folder: Path, devices: int | None = None, sinks: Sequence[Sink] = ()
) -> dict[str, Any]:
    """Trains from scratch and writes the run directory.

    Args:
        folder: where to; must be empty or not there.
        devices: how many share the environments, all that divide them when None.
        sinks: further listeners.

    Returns:
        the content of summary.json.

    Raises:
        InputError: anything the user can put right; nothing has been written then.
        StoppedError: a signal asked for it; `resume` goes on.
        DivergedError: a figure that is not finite.
        LostProcessError: one of several processes is gone (see `distributed.join`).
    """
    directory = RunDirectory(folder)
    with ending_together(_how_to_resume(folder)):
        with synchronized(settings):
            check_settings(settings)
            num_devices = choose_num_devices(devices, settings.agent.device_divisor)
            check_free(folder)
            build(settings, num_devices)
        with synchronized():
            directory.create(settings, num_devices)
        return _go(settings, directory, num_devices, sinks, resumed=False)


def resume(
    settings: RunSettings, folder: Path, devices: int | None = None, sinks: Sequence[Sink] = ()
) -> dict[str, Any]:
    """Resumes a training that was stopped, as if it had not been, or with more iterations.

    Args:
        settings: of the run in `folder`; iterations, goal ratio to stop at and patience may have
            changed.
        devices: as many as before when None.
        sinks: further listeners.

    Raises:
        InputError: the folder holds no run, one of other settings, or nothing to resume from.
        StoppedError, DivergedError, LostProcessError: see `train`.
    """
    directory = RunDirectory(folder)
    with ending_together(_how_to_resume(folder)):
        with synchronized(settings):
            check_settings(settings)
            differing = directory.differences(settings)
            if differing:
                differing = ", ".join(differing)
                raise InputError(f"{folder}: holds a run that differs in {differing}; leave these out")
            before = directory.num_devices()
            if devices is None and jax.process_count() == 1 and (before or 0) <= len(jax.devices()):
                devices = before
            num_devices = choose_num_devices(devices, settings.agent.device_divisor)
        return _go(settings, directory, num_devices, sinks, resumed=True)


def _how_to_resume(folder: Path) -> str:
    return f"resume with pecjax train --resume --out {folder}"


def _go(
    settings: RunSettings,
    directory: RunDirectory,
    num_devices: int,
    sinks: Sequence[Sink],
    resumed: bool,
) -> dict[str, Any]:
    folder = directory.folder
    with synchronized():  # each reads what the first has written
        settings = dataclasses.replace(settings, task=settings.task.kept_in(folder))
        run = build(settings, num_devices)
    actions = f"{settings.evaluation.episodes} {'greedy' if settings.evaluation.greedy else 'sampled'}"
    with (
        alone(folder),
        Progress(settings.stop.iterations, actions) as progress,
        Interruption() as interruption,
    ):
        session = Session(settings, run, directory, progress, Clock())
        _introduce(session, resumed)
        with writing(folder, f"put that right and {_how_to_resume(folder)}"):
            position, iterate = _resumed(session) if resumed else _begun(session)
            progress.say(f"compiled in {session.clock.compile_seconds:.1f} s")
            return _loop(session, position, iterate, sinks, interruption)


def _introduce(session: Session, resumed: bool) -> None:
    """Says what is trained, on what."""
    settings, run, directory, progress, _ = session
    agent, num_devices, available = settings.agent, run.mesh.devices.size, len(jax.devices())
    advice = "" if resumed else advice_on_idle_devices(agent.num_envs, agent.device_divisor, num_devices)
    on = f"{num_devices} of {available} devices{advice}" if available > 1 else "1 device"
    progress.say(f"{directory.folder}: {agent.num_envs} environments on {on}")
    for line in settings.task.notices(run.task, run.world):
        progress.say(f"notice: {line}")
    if run.agent.replay_bytes:
        progress.say(f"replay: {run.agent.replay_bytes / 1e6:,.0f} MB")


def _begun(session: Session) -> tuple[Position, Iterate]:
    with session.clock.compiling():
        state, iterate = start(session.run, session.settings.seed)
    return Position(state), iterate


def _resumed(session: Session) -> tuple[Position, Iterate]:
    """The newest state to resume from; the tables are rolled back to it."""
    settings, run, directory, progress, clock = session
    folder, stop = directory.folder, settings.stop
    checkpoints = Checkpoints(folder, directory.identity())
    there, warnings = checkpoints.load_state(ResumeState.make(abstract_state(run), 0, 0, 0.0))
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
    directory.record(settings_as_begun(session), run.mesh.devices.size, from_iteration=done)
    checkpoints.forget_after(done, settings.evaluation.every)
    progress.say(f"resumes after iteration {done}")
    progress.skip(done)
    clock.spent_before = float(there.seconds)
    with clock.compiling():
        return Position(there.state, done, patience_count), compile_iteration(run)


def settings_as_begun(session: Session) -> RunSettings:
    """The session's settings with the names of the task's files as they were given."""
    return dataclasses.replace(session.settings, task=session.directory.settings().task)


def _roll_back(session: Session, done: int) -> None:
    """Removes what a run of which so many iterations are done would not have."""
    settings, directory, progress = session.settings, session.directory, session.progress
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


def _loop(
    session: Session,
    position: Position,
    iterate: Iterate,
    sinks: Sequence[Sink],
    interruption: Interruption,
) -> dict[str, Any]:
    settings, run, directory, progress, clock = session
    folder = directory.folder
    checkpoints = Checkpoints(folder, directory.identity())
    saved = position.iteration
    asked = 0

    def diverged(_: int, iteration: int, names: list[str]) -> None:
        good = f"iteration {saved} is the last good checkpoint" if saved else "there is no checkpoint yet"
        raise DivergedError(f"{folder}: at iteration {iteration} not finite: {', '.join(names)}; {good}")

    def save(standing: Ending) -> None:
        """A checkpoint comes last of all that belongs to its iteration."""
        nonlocal saved
        there = standing.position
        if standing.evaluation:
            checkpoints.save_learner(there.iteration, there.state.learner)
        if standing.finished:
            directory.write_json("summary.json", summarize(settings, standing, clock))
        checkpoints.save_state(ResumeState.make(*there, clock.seconds()))
        saved = there.iteration

    def is_asked() -> bool:
        nonlocal asked
        asked = greatest(interruption.asked or 0)
        return bool(asked)

    program = one_run(run, settings, iterate, clock.compiling)
    listeners = [RunFiles(directory, clock), progress, *sinks]
    with Sinks(listeners, [str(folder)], position.iteration) as told:
        ending = run_loop(program, position, settings, told, Hooks(diverged, save, is_asked))
    if not ending.finished:
        raise StoppedError(
            f"stopped after iteration {ending.position.iteration}; {_how_to_resume(folder)}",
            signal.Signals(asked),
        )
    return summarize(settings, ending, clock)


def summarize(settings: RunSettings, ending: Ending, clock: Clock) -> dict[str, Any]:
    """The content of summary.json."""
    (row,), (evaluated,), seconds = ending.metrics, ending.evaluation, clock.seconds()
    return {
        "iterations": row["iteration"],
        "env_steps": row["env_steps"],
        "seconds": round(seconds, 2),
        "compile_seconds": round(clock.compile_seconds, 2),
        "steps_per_second": round(row["env_steps"] / seconds, 1),
        "training_goal_ratio": row["goal_ratio"],
        "uniform_evaluation": {
            "episodes": settings.evaluation.episodes,
            "greedy": settings.evaluation.greedy,
            "goal_ratio": evaluated["goal_ratio"],
            "mean_return": evaluated["mean_return"],
        },
    }
