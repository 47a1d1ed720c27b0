"""Training: runs from scratch or resumes."""

from __future__ import annotations

import dataclasses
import math
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from pecjax.errors import DivergedError, InputError, StoppedError
from pecjax.runtime.devices import advice_on_idle_devices, choose_num_devices
from pecjax.runtime.distributed import ending_together, greatest, synchronized
from pecjax.runtime.signals import Interruption
from pecjax.storage.files import alone, check_free, writing
from pecjax.training.build import Run, build
from pecjax.training.checkpoint import Checkpoints, ResumeState
from pecjax.training.loop import Clock, Ending, Hooks, Position, run_loop
from pecjax.training.program import Iterate, one_run
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_files import RunFiles
from pecjax.training.session import Session, resumed, started
from pecjax.training.settings import RunSettings, check_settings
from pecjax.training.sinks import Progress, Sink, Sinks


def train(
    settings: RunSettings, folder: Path, devices: int | None = None, sinks: Sequence[Sink] = ()
) -> dict[str, Any]:
    """Trains from scratch and writes the run directory.

    Args:
        folder: the run's folder, which must be empty or not exist.
        devices: how many share the environments, all that divide them when None.
        sinks: further listeners.

    Returns:
        the content of summary.json.

    Raises:
        InputError: wrong input; nothing has been written then.
        StoppedError: a signal asked for it; `resume` continues it.
        DivergedError: a figure that is not finite.
        LostProcessError: one of several processes is gone (see `distributed.join`).
    """
    directory = RunDirectory(folder)
    with ending_together(_how_to_resume(folder)):
        with synchronized(settings):
            check_settings(settings)
            _check(sinks)
            num_devices = choose_num_devices(devices, settings.agent.device_divisor, settings.agent.divided)
            check_free(folder)
            build(settings, num_devices, prepares=False)
        with synchronized():
            directory.create(settings, num_devices)
        return _go(settings, directory, num_devices, sinks, is_resumed=False)


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
        InputError: the folder holds no run, one of other settings or of another version, or nothing to
            resume from.
        StoppedError, DivergedError, LostProcessError: see `train`.
    """
    directory = RunDirectory(folder)
    with ending_together(_how_to_resume(folder)):
        with synchronized(settings):
            check_settings(settings)
            _check(sinks)
            directory.check_version()
            differing = directory.differences(settings)
            if differing:
                differing = ", ".join(differing)
                raise InputError(f"{folder}: holds a run that differs in {differing}; leave these out")
            before = directory.num_devices()
            if devices is None and jax.process_count() == 1 and (before or 0) <= len(jax.devices()):
                devices = before
            num_devices = choose_num_devices(devices, settings.agent.device_divisor, settings.agent.divided)
        return _go(settings, directory, num_devices, sinks, is_resumed=True)


def _check(sinks: Sequence[Sink]) -> None:
    for sink in sinks:
        sink.check()


def _how_to_resume(folder: Path) -> str:
    return f"resume with pecjax train --resume --out {folder}"


def _go(
    settings: RunSettings,
    directory: RunDirectory,
    num_devices: int,
    sinks: Sequence[Sink],
    is_resumed: bool,
) -> dict[str, Any]:
    folder, given = directory.folder, settings.task
    with synchronized():  # each reads what the first has written
        settings = dataclasses.replace(settings, task=settings.task.kept_in(folder))
        run = build(settings, num_devices)
    # The files that a run keeps no longer show what was added to those that it was given.
    notices = (settings.task if is_resumed else given).notices(run.task, run.world)
    about = settings.evaluation
    episodes = f"{about.episodes} {'greedy' if about.greedy else 'sampled'} episodes"
    with (
        alone(folder),
        Progress(settings.stop.iterations, episodes) as progress,
        Interruption() as interruption,
    ):
        _introduce(settings, run, directory, progress, is_resumed, notices)
        session = Session(settings, run, directory, progress, Clock())
        with writing(folder, f"put that right and {_how_to_resume(folder)}"):
            position, iterate = resumed(session) if is_resumed else started(session)
            progress.say(f"compiled in {session.clock.compile_seconds:.1f} s")
            return _loop(session, position, iterate, sinks, interruption)


def _introduce(
    settings: RunSettings,
    run: Run,
    directory: RunDirectory,
    progress: Progress,
    is_resumed: bool,
    notices: Sequence[str],
) -> None:
    """Prints what is trained, and on which devices."""
    agent, num_devices, available = settings.agent, run.mesh.devices.size, len(jax.devices())
    advice = ""
    if not is_resumed:
        advice = advice_on_idle_devices(agent.num_envs, agent.device_divisor, agent.divided, num_devices)
    on = f"{num_devices} of {available} devices{advice}" if available > 1 else "1 device"
    progress.say(f"{directory.folder}: {agent.num_envs} environments on {on}")
    for line in notices:
        progress.say(f"notice: {line}")
    if run.agent.replay_bytes:
        progress.say(f"replay: {run.agent.replay_bytes / 1e6:,.0f} MB")


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
    summary: dict[str, Any] = {}

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
            summary.update(summarize(settings, standing, clock))
            directory.write_json("summary.json", summary)
        checkpoints.save_state(ResumeState.make(there.state, there.iteration, clock.seconds()))
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
    return summary


def summarize(settings: RunSettings, ending: Ending, clock: Clock) -> dict[str, Any]:
    """The content of summary.json."""
    (row,), (evaluated,), seconds = ending.metrics, ending.evaluation, clock.seconds()
    return {
        "iterations": row["iteration"],
        "env_steps": row["env_steps"],
        "seconds": round(seconds, 2),
        "compile_seconds": round(clock.compile_seconds, 2),
        "steps_per_second": round(row["env_steps"] / seconds, 1),
        "training_goal_ratio": None if math.isnan(row["goal_ratio"]) else row["goal_ratio"],
        "uniform_evaluation": {
            "episodes": settings.evaluation.episodes,
            "greedy": settings.evaluation.greedy,
            "goal_ratio": evaluated["goal_ratio"],
            "mean_return": evaluated["mean_return"],
        },
    }
