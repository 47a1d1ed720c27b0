"""The host's loop, for one run or several: one iteration after the other, and who is told of each."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from pecjax.agents import TrainState
from pecjax.storage.tables import Row
from pecjax.training.program import Program
from pecjax.training.rows import (
    configuration_arrays,
    episode_arrays,
    evaluation_row,
    metrics_row,
    recording_arrays,
)
from pecjax.training.settings import RunSettings, StopSettings
from pecjax.training.sinks import Sink


class Clock:
    """Wall-clock seconds of training, compilation apart, with those before a stop."""

    def __init__(self) -> None:
        """Begins to count."""
        self._started = time.perf_counter()
        self.compile_seconds = 0.0
        self.spent_before = 0.0

    def seconds(self) -> float:
        """So far."""
        return self.spent_before + time.perf_counter() - self._started - self.compile_seconds

    @contextlib.contextmanager
    def compiling(self) -> Iterator[None]:
        """What happens within is compilation."""
        started = time.perf_counter()
        yield
        self.compile_seconds += time.perf_counter() - started


class Position(NamedTuple):
    """Where the loop stands.

    Attributes:
        state: of all runs.
        iteration: how many are done.
        patience_count: iterations in a row at or above the goal ratio to stop at.
    """

    state: TrainState
    iteration: int = 0
    patience_count: int = 0


class Ending(NamedTuple):
    """How the loop ended, or how it stands.

    Attributes:
        position: where.
        finished: whether it is at its end; else it was asked to stop, or every run has diverged.
        metrics, evaluation: rows of each run after the last iteration; no evaluation if none was due.
    """

    position: Position
    finished: bool
    metrics: list[Row]
    evaluation: list[Row]


@dataclass(frozen=True)
class Hooks:
    """What the loop asks of whoever runs it.

    Attributes:
        diverged: (run, iteration, names of what is not finite); it may raise, else the others continue.
        saved: (how it stands), after an evaluation or before a stop, once all sinks know of it.
        asked: whether to stop.
        lookahead: how many iterations are enqueued before the host looks at the first: the devices then
            never wait for it.
    """

    diverged: Callable[[int, int, list[str]], None]
    saved: Callable[[Ending], None] = lambda standing: None
    asked: Callable[[], bool] = lambda: False
    lookahead: int = 1


def is_evaluated(settings: RunSettings, iteration: int) -> bool:
    """Whether an iteration is followed by an evaluation, even if it is not the last."""
    return iteration % settings.evaluation.every == 0


def is_counted(settings: RunSettings, iteration: int) -> bool:
    """Whether an iteration has a file in `configurations/`, even if it is not the last."""
    return iteration == 1 or iteration % settings.configurations_every == 0


def streak(goal_ratios: Sequence[float], stop: StopSettings) -> int:
    """How many of the last training goal ratios in a row reach the one to stop at; 0 where there is none."""
    threshold = stop.until_goal_ratio
    missed = [threshold is None or not ratio >= threshold for ratio in reversed(goal_ratios)]
    return missed.index(True) if True in missed else len(missed)


def run_loop(program: Program, start: Position, settings: RunSettings, sink: Sink, hooks: Hooks) -> Ending:
    """Iterates to the end: the settings' iterations, or a goal ratio that was held long enough.

    Only a single run can stop at a goal ratio.
    """
    state, iteration, patience_count = start
    active = set(range(program.num_runs))
    last_metrics: list[Row] = []

    while True:
        # Only enqueued: the devices do not wait for the host meanwhile.
        enqueued = []
        for _ in range(_stretch(settings, iteration, hooks.lookahead)):
            state, metrics = program.iterate(state)
            enqueued.append(metrics)
        for metrics in jax.device_get(enqueued):
            iteration += 1
            for run in sorted(active):
                if names := _of_run(metrics, run).non_finite:
                    active.remove(run)
                    hooks.diverged(run, iteration, names)
            steps = iteration * program.steps_per_iteration
            last_metrics = [metrics_row(iteration, steps, one) for one in _by_run(program, metrics)]
            sink.rows("metrics", last_metrics)
        patience_count = patience_count + 1 if streak([last_metrics[0]["goal_ratio"]], settings.stop) else 0
        last = iteration == settings.stop.iterations or patience_count == settings.stop.patience
        if last or is_counted(settings, iteration):
            found = _by_run(program, (program.counts(state), program.probabilities(state)))
            arrays = [configuration_arrays(*of_run) for of_run in found]
            sink.arrays("configurations", iteration, arrays)
        evaluation: list[Row] = []
        if last or is_evaluated(settings, iteration):
            results = _by_run(program, program.evaluate(state))
            steps = iteration * program.steps_per_iteration
            evaluation = [evaluation_row(iteration, steps, one, program.eval_set) for one in results]
            episodes = [episode_arrays(one) | (recording_arrays(one) if last else {}) for one in results]
            sink.rows("evaluation", evaluation)
            sink.arrays("episodes", iteration, episodes)
        asked = hooks.asked()
        standing = Ending(Position(state, iteration, patience_count), last, last_metrics, evaluation)
        if evaluation or asked:
            hooks.saved(standing)
        if last or asked or not active:
            return standing


def _stretch(settings: RunSettings, iteration: int, lookahead: int) -> int:
    """How many iterations there are until the host has something to do, or so many if there are fewer."""
    number = 1
    while number < lookahead:
        after = iteration + number
        if after == settings.stop.iterations or is_evaluated(settings, after) or is_counted(settings, after):
            break
        number += 1
    return number


def _of_run(tree: Any, run: int) -> Any:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[run], tree)


def _by_run(program: Program, tree: Any) -> list[Any]:
    return [_of_run(tree, run) for run in range(program.num_runs)]
