"""Progress: what a person sees while a run goes on."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

SECONDS_BETWEEN_LINES = 10.0  # where there is no terminal to draw a bar on


class RunProgress:
    """A live bar on a terminal, else a line every few seconds, both on stderr."""

    def __init__(self, iterations: int) -> None:
        """Prepares a bar of so many iterations; it shows with the first `advance`."""
        self._console = Console(stderr=True, highlight=False, soft_wrap=True)
        self._iterations = iterations
        self._last_line = -SECONDS_BETWEEN_LINES
        self._bar = Progress(
            TextColumn("training"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("training", total=iterations, figures="")

    def __enter__(self) -> RunProgress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def say(self, line: str) -> None:
        """Prints a line above the bar."""
        self._console.print(line, markup=False)

    def advance(self, iteration: int, goal_ratio: float, steps_per_second: float, seconds: float) -> None:
        """Shows that `iteration` iterations are done, in so many seconds."""
        left = seconds / iteration * (self._iterations - iteration)
        figures = f"training goal ratio {goal_ratio:.3f}, {steps_per_second:,.0f} steps/s"
        self._bar.start()
        self._bar.update(self._task, completed=iteration, figures=figures)
        now = time.monotonic()
        due = now - self._last_line >= SECONDS_BETWEEN_LINES or iteration == self._iterations
        if due and not self._console.is_terminal:
            self._last_line = now
            self.say(f"iteration {iteration}/{self._iterations}: {figures}, {left:.0f} s left")
