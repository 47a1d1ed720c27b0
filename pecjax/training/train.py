"""Training: a run from scratch, or resumed where it was stopped."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pecjax.agents.agent import TrainState
from pecjax.envs.rooms.notices import world_notices
from pecjax.envs.rooms.scene import load_scene
from pecjax.errors import InputError
from pecjax.runtime.devices import advice_on_idle_devices, choose_num_devices
from pecjax.runtime.distributed import ending_together, synchronized
from pecjax.runtime.signals import Interruption
from pecjax.storage.files import alone, check_free, writing
from pecjax.training.build import Run, abstract_state, build, load_world
from pecjax.training.checkpoint import Checkpoints, ResumeState
from pecjax.training.loop import Clock, Iterate, Session, is_counted, is_evaluated, loop, streak
from pecjax.training.presets import RunSettings, check_settings
from pecjax.training.progress import Progress
from pecjax.training.run_directory import RunDirectory


def start(run: Run, seed: int) -> tuple[TrainState, Iterate]:
    """The first state and the compiled iteration, the one prepared while the other compiles."""
    key = jax.random.key(seed)
    init = jax.jit(run.agent.init).lower(key)
    with ThreadPoolExecutor(1) as aside:
        state = aside.submit(lambda: init.compile()(key))
        iterate = compile_iteration(run)
        return state.result(), iterate


def compile_iteration(run: Run) -> Iterate:
    """The iteration as a compiled program; it takes the place of the state it is given."""
    return jax.jit(run.agent.iterate, donate_argnums=0).trace(abstract_state(run)).lower().compile()


def train(settings: RunSettings, folder: Path, devices: int | None = None) -> dict[str, Any]:
    """Trains from scratch and writes the run directory.

    Args:
        folder: where to; must be empty or not there.
        devices: how many share the environments, all that divide them when None.

    Returns:
        the content of summary.json.

    Raises:
        InputError: anything the user can put right; nothing has been written then.
        StoppedError: a signal asked for it; `resume` goes on.
        DivergedError: a figure that is not finite.
        LostProcessError: one of several processes is gone (see `processes.join`).
    """
    directory = RunDirectory(folder)
    with ending_together(_how_to_go_on(folder)):
        with synchronized(settings):
            check_settings(settings)
            num_devices = choose_num_devices(devices, settings.learner.shares)
            scene_path, scene, table = load_world(settings)
            build(settings, scene, table, num_devices)
            check_free(folder)
        with synchronized():
            directory.create(settings, scene_path, table, num_devices)
        return _go(settings, directory, num_devices, resumed=False)


def resume(settings: RunSettings, folder: Path, devices: int | None = None) -> dict[str, Any]:
    """Goes on with a training that was stopped, as if it had not been, or with more iterations.

    Args:
        settings: of the run in `folder`; iterations, goal ratio to stop at and patience may have
            changed.
        devices: as many as before when None.

    Raises:
        InputError: the folder holds no run, one of other settings, or nothing to go on from.
        StoppedError, DivergedError, LostProcessError: see `train`.
    """
    directory = RunDirectory(folder)
    with ending_together(_how_to_go_on(folder)):
        with synchronized(settings):
            check_settings(settings)
            differing = directory.differences(settings)
            if differing:
                differing = ", ".join(differing)
                raise InputError(f"{folder}: holds a run that differs in {differing}; leave these out")
            before = directory.num_devices()
            if devices is None and jax.process_count() == 1 and (before or 0) <= len(jax.devices()):
                devices = before
            num_devices = choose_num_devices(devices, settings.learner.shares)
        return _go(settings, directory, num_devices, resumed=True)


def _how_to_go_on(folder: Path) -> str:
    return f"go on with pecjax train --resume --out {folder}"


def _go(settings: RunSettings, directory: RunDirectory, num_devices: int, resumed: bool) -> dict[str, Any]:
    folder = directory.folder
    with synchronized():  # each reads what the lead has written
        scene = load_scene(directory.scene_path, settings.resolution)
        run = build(settings, scene, directory.table(), num_devices)
    with alone(folder), Progress(settings.iterations) as progress, Interruption() as interruption:
        learner, available = settings.learner, len(jax.devices())
        advice = "" if resumed else advice_on_idle_devices(learner.num_envs, learner.shares, num_devices)
        on = f"{num_devices} of {available} devices{advice}" if available > 1 else "1 device"
        progress.say(f"{folder}: {learner.num_envs} environments on {on}")
        for line in world_notices(scene, run.table):
            progress.say(f"notice: {line}")
        if run.agent.replay_bytes:
            progress.say(f"replay: {run.agent.replay_bytes / 1e6:,.0f} MB")
        session = Session(settings, run, directory, progress, interruption, Clock())
        with writing(folder, f"put that right and {_how_to_go_on(folder)}"):
            here, iterate = _go_on(session) if resumed else _begin(session)
            progress.say(f"compiled in {session.clock.compile_seconds:.1f} s")
            return loop(session, here, iterate)


def _begin(session: Session) -> tuple[ResumeState, Iterate]:
    with session.clock.compiling():
        state, iterate = start(session.run, session.settings.seed)
    return ResumeState.make(state, 0, _no_counts(session.run), 0, 0.0), iterate


def _go_on(session: Session) -> tuple[ResumeState, Iterate]:
    """The newest position to go on from; the tables are rolled back to it."""
    settings, run, directory, progress, _, clock = session
    folder = directory.folder
    checkpoints = Checkpoints(folder, directory.identity())
    here, said = checkpoints.load_position(ResumeState.make(abstract_state(run), 0, _no_counts(run), 0, 0.0))
    for line in said:
        progress.say(line)
    done = int(here.iteration)
    if done >= settings.iterations:
        raise InputError(f"{folder}: already finished at iteration {done}; give a greater --iterations")
    held = 0
    if settings.until_goal_ratio is not None:  # it may be another than before: what `here` counted is stale
        ratios = directory.column("metrics.csv", "goal_ratio", lambda row: row <= done)
        held = streak(ratios, settings.until_goal_ratio)
    if held >= settings.patience:
        raise InputError(
            f"{folder}: already finished at iteration {done}: the last {held} iterations reached a goal "
            f"ratio of {settings.until_goal_ratio:g}; give a higher --until-goal-ratio or more --patience"
        )
    here = here._replace(held=np.array(held))
    # What only the end of a shorter run had written is not in the tables of a longer one.
    directory.remove("summary.json", "trajectories.csv")
    for name, keep in (
        ("metrics.csv", lambda row: row <= done),
        ("evaluation.csv", lambda row: row <= done and is_evaluated(settings, row)),
        ("configurations.csv", lambda row: row <= done and is_counted(settings, row)),
    ):
        before = (folder / name).exists()
        directory.roll_back(name, keep)
        if before and not (folder / name).exists():
            progress.say(f"{folder / name}: had no whole first line; begins again after iteration {done}")
    directory.record(settings, run.mesh.devices.size, from_iteration=done)
    checkpoints.forget_after(done, settings.evaluate_every)
    progress.say(f"goes on after iteration {done}")
    progress.skip(done)
    clock.spent_before = float(here.seconds)
    with clock.compiling():
        return here, compile_iteration(run)


def _no_counts(run: Run) -> np.ndarray:
    return np.zeros((2, run.table.size), np.int64)
