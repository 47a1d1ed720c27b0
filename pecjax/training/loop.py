"""The host's loop: one iteration after the other, and what is written of each."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from pecjax.agents.agent import Metrics, TrainState
from pecjax.errors import DivergedError, StoppedError
from pecjax.runtime.distributed import greatest
from pecjax.runtime.signals import Interruption
from pecjax.training import rows as tables
from pecjax.training.build import Run, compile_evaluator
from pecjax.training.checkpoint import Checkpoints, ResumeState
from pecjax.training.presets import RunSettings
from pecjax.training.progress import Progress
from pecjax.training.run_directory import RunDirectory

Iterate = Callable[[TrainState], tuple[TrainState, Metrics]]


class Clock:
    """Wall-clock seconds of training, compilation apart, with those before a stop."""

    def __init__(self) -> None:
        """Begins to count."""
        self._begun = time.perf_counter()
        self.compile_seconds = 0.0
        self.spent_before = 0.0

    def seconds(self) -> float:
        """So far."""
        return self.spent_before + time.perf_counter() - self._begun - self.compile_seconds

    @contextlib.contextmanager
    def compiling(self) -> Iterator[None]:
        """What happens within is compilation."""
        begun = time.perf_counter()
        yield
        self.compile_seconds += time.perf_counter() - begun


class Session(NamedTuple):
    """A training in one process, from its start or from where it goes on, to its end or a stop."""

    settings: RunSettings
    run: Run
    directory: RunDirectory
    progress: Progress
    interruption: Interruption
    clock: Clock


def is_evaluated(settings: RunSettings, iteration: int) -> bool:
    """Whether an iteration is followed by an evaluation, even if it is not the last."""
    return iteration % settings.evaluate_every == 0


def is_counted(settings: RunSettings, iteration: int) -> bool:
    """Whether an iteration has rows in configurations.csv, even if it is not the last."""
    return iteration == 1 or iteration % settings.configurations_every == 0


def streak(goal_ratios: Sequence[float], threshold: float | None) -> int:
    """How many of the last training goal ratios in a row reach the threshold; 0 where it is None."""
    missed = [threshold is None or not ratio >= threshold for ratio in reversed(goal_ratios)]
    return missed.index(True) if True in missed else len(missed)


def loop(session: Session, here: ResumeState, iterate: Iterate) -> dict[str, Any]:
    """Iterates from a position to the end, and returns the content of summary.json.

    A checkpoint comes last of all that belongs to its iteration: what the tables have up to there,
    a training that goes on from it has too.

    Raises:
        StoppedError: a signal asked for it.
        DivergedError: a figure that is not finite.
    """
    settings, run, directory, progress, interruption, clock = session
    checkpoints = Checkpoints(directory.folder, directory.identity())
    probabilities = jax.jit(run.sampler.probabilities)
    state, iteration, counts, held = here.state, int(here.iteration), here.counts, int(here.held)
    saved = iteration
    evaluate = None
    while True:
        iteration += 1
        state, metrics = iterate(state)
        metrics = jax.device_get(metrics)
        _check_finite(metrics, iteration, saved, directory)
        counts = counts + metrics.counts
        row = tables.metrics_row(iteration, run.agent.steps_per_iteration, clock.seconds(), metrics)
        directory.append("metrics.csv", [row])
        held = held + 1 if streak([row["goal_ratio"]], settings.until_goal_ratio) else 0
        last = iteration == settings.iterations or held == settings.patience
        if last or is_counted(settings, iteration):
            drawn_with = np.asarray(probabilities(state.sampler))
            directory.append("configurations.csv", tables.configuration_rows(iteration, counts, drawn_with))
        evaluated = {}
        if last or is_evaluated(settings, iteration):
            if evaluate is None:
                with clock.compiling():
                    evaluate = compile_evaluator(run, settings, state.learner)
            flights = evaluate(state.learner)
            evaluated = tables.evaluation_row(iteration, row["env_steps"], flights, run.table.size)
            directory.append("evaluation.csv", [evaluated])
            if last:
                directory.append("trajectories.csv", tables.path_rows(flights, run.table.size))
            checkpoints.save_learner(iteration, state.learner)
            progress.say(
                f"iteration {iteration}: goal ratio {evaluated['goal_ratio']:.3f} over {len(flights.goal)} "
                f"{'greedy' if settings.greedy else 'sampled'} episodes of a uniform draw"
            )
        rate = row["env_steps"] / clock.seconds()
        ended = int(metrics.reported[0])
        ratio = f"{row['goal_ratio']:.3f} of {ended} episode(s)" if ended else "not known yet"
        progress.advance(1, f"training goal ratio {ratio}, {rate:,.0f} steps/s")
        asked = greatest(interruption.asked or 0)
        summary = _summary(settings, row, evaluated, clock) if last else {}
        if last:
            directory.write_json("summary.json", summary)
        if evaluated or asked:
            checkpoints.save_position(ResumeState.make(state, iteration, counts, held, clock.seconds()))
            saved = iteration
        if last:
            return summary
        if asked:
            command = f"pecjax train --resume --out {directory.folder}"
            raise StoppedError(
                f"stopped after iteration {iteration}; go on with {command}", signal.Signals(asked)
            )


def _check_finite(metrics: Metrics, iteration: int, saved: int, directory: RunDirectory) -> None:
    if metrics.non_finite:
        good = f"iteration {saved} is the last good checkpoint" if saved else "there is no checkpoint yet"
        names = ", ".join(metrics.non_finite)
        raise DivergedError(f"{directory.folder}: at iteration {iteration} not finite: {names}; {good}")


def _summary(settings: RunSettings, row: tables.Row, evaluated: tables.Row, clock: Clock) -> dict[str, Any]:
    seconds = clock.seconds()
    return {
        "iterations": row["iteration"],
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
