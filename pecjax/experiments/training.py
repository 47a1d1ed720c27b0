"""Training: the host's loop around an agent's iterations."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pecjax.agents.agent import Metrics, TrainState
from pecjax.experiments import tables
from pecjax.experiments.assembly import Run, build, compile_evaluator, load_world
from pecjax.experiments.checkpoint import Checkpoints
from pecjax.experiments.devices import choose_num_devices
from pecjax.experiments.plain_files import check_free
from pecjax.experiments.presets import RunSettings, check_settings
from pecjax.experiments.progress import Progress
from pecjax.experiments.run_directory import RunDirectory
from pecjax.world.scene import load_scene


def start(run: Run, seed: int) -> tuple[TrainState, Callable[[TrainState], tuple[TrainState, Metrics]]]:
    """The first state and the compiled iteration, the one prepared while the other compiles."""
    key = jax.random.key(seed)
    init = jax.jit(run.agent.init).lower(key)
    with ThreadPoolExecutor(1) as aside:
        state = aside.submit(lambda: init.compile()(key))
        iterate = jax.jit(run.agent.iterate, donate_argnums=0).trace(init.out_info)
        return state.result(), iterate.lower().compile()


def train(settings: RunSettings, folder: Path, devices: int | None = None) -> dict[str, Any]:
    """Trains from scratch and writes the run directory.

    Args:
        folder: where to; must be empty or not there.
        devices: how many share the environments, all that divide them when None.

    Returns:
        the content of summary.json.

    Raises:
        InputError: anything the user can put right; nothing has been written then.
    """
    check_settings(settings)
    num_devices = choose_num_devices(devices, settings.learner.shares)
    scene_path, scene, table = load_world(settings)
    build(settings, scene, table, num_devices)
    check_free(folder)
    directory = RunDirectory(folder)
    directory.create(settings, scene_path, table, num_devices)
    run = build(settings, load_scene(directory.scene_path, settings.resolution), table, num_devices)
    with Progress(settings.iterations) as progress:
        progress.say(f"{folder}: {settings.learner.num_envs} environments on {num_devices} device(s)")
        if run.agent.replay_bytes:
            progress.say(f"replay: {run.agent.replay_bytes / 1e6:,.0f} MB")
        return _loop(settings, run, directory, progress)


def _loop(settings: RunSettings, run: Run, directory: RunDirectory, progress: Progress) -> dict[str, Any]:
    checkpoints = Checkpoints(directory.folder)
    clock = _Clock()
    with clock.compiling():
        state, iterate = start(run, settings.seed)
        probabilities = jax.jit(run.sampler.probabilities)
    progress.say(f"compiled in {clock.compile_seconds:.1f} s")

    counts = np.zeros((2, run.table.size), np.int64)
    evaluate = None
    row, evaluated = {}, {}
    held, last, iteration = 0, False, 0
    while not last:
        iteration += 1
        state, metrics = iterate(state)
        metrics = jax.device_get(metrics)
        counts += metrics.counts
        row = tables.metrics_row(iteration, run.agent.steps_per_iteration, clock.seconds(), metrics)
        directory.append("metrics.csv", [row])
        goal_ratio = settings.until_goal_ratio
        held = held + 1 if goal_ratio is not None and row["goal_ratio"] >= goal_ratio else 0
        last = iteration == settings.iterations or held == settings.patience
        if iteration == 1 or iteration % settings.configurations_every == 0 or last:
            drawn_with = np.asarray(probabilities(state.sampler))
            directory.append("configurations.csv", tables.configuration_rows(iteration, counts, drawn_with))
        if iteration % settings.evaluate_every == 0 or last:
            checkpoints.save(iteration, state)
            if evaluate is None:
                with clock.compiling():
                    evaluate = compile_evaluator(run, settings, state.learner)
            flights = evaluate(state.learner)
            evaluated = tables.evaluation_row(iteration, row["env_steps"], flights, run.table.size)
            directory.append("evaluation.csv", [evaluated])
            progress.say(
                f"iteration {iteration}: goal ratio {evaluated['goal_ratio']:.3f} over {len(flights.goal)} "
                f"{'greedy' if settings.greedy else 'sampled'} episodes of a uniform draw"
            )
            if last:
                directory.append("trajectories.csv", tables.path_rows(flights, run.table.size))
        rate = row["env_steps"] / clock.seconds()
        progress.advance(1, f"training goal ratio {row['goal_ratio']:.3f}, {rate:,.0f} steps/s")

    seconds = clock.seconds()
    summary = {
        "iterations": iteration,
        "env_steps": row["env_steps"],
        "seconds": round(seconds, 2),
        "compile_seconds": round(clock.compile_seconds, 2),
        "steps_per_second": round(row["env_steps"] / seconds, 1),
        "training_goal_ratio": row["goal_ratio"],
        "uniform_evaluation": {
            "episodes": settings.evaluation_episodes,
            "greedy": settings.greedy,
            "goal_ratio": evaluated["goal_ratio"],
            "mean_return": evaluated["mean_return"],
        },
    }
    directory.write_json("summary.json", summary)
    return summary


class _Clock:
    """Wall-clock seconds since training began, compilation apart."""

    def __init__(self) -> None:
        self._begun = time.perf_counter()
        self.compile_seconds = 0.0

    def seconds(self) -> float:
        return time.perf_counter() - self._begun - self.compile_seconds

    @contextlib.contextmanager
    def compiling(self) -> Iterator[None]:
        begun = time.perf_counter()
        yield
        self.compile_seconds += time.perf_counter() - begun
