"""Progress: what a person sees while a training or a study goes on."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress as Bar, TextColumn, TimeRemainingColumn

from pecjax.runtime.distributed import is_primary

SECONDS_BETWEEN_LINES = 10.0  # where there is no terminal to draw a bar on


class Progress:
    """A live bar over iterations on a terminal, else a line every few seconds, both on stderr."""

    def __init__(self, iterations: int) -> None:
        """Prepares a bar of so many iterations; it shows with the first `advance`."""
        self._console = Console(stderr=True, highlight=False, soft_wrap=True, quiet=not is_primary())
        self._iterations = iterations
        self._done = 0
        self._since: tuple[float, int] | None = None  # when its pace began to count, and at what
        self._last_line = -SECONDS_BETWEEN_LINES
        self._bar = Bar(
            TextColumn("training"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=self._console,
            disable=self._console.quiet or not self._console.is_terminal,
        )
        self._task = self._bar.add_task("training", total=iterations, figures="")

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def say(self, line: str) -> None:
        """Prints a line above the bar."""
        self._console.print(line, markup=False)

    def skip(self, iterations: int) -> None:
        """Counts so many iterations as done before."""
        self._done += iterations

    def advance(self, iterations: int, figures: str) -> None:
        """Shows that so many more iterations are done."""
        self._done += iterations
        self._bar.start()
        self._bar.update(self._task, completed=self._done, figures=figures)
        now = time.monotonic()
        since, done = self._since = self._since or (now, self._done)  # compilation came before
        due = now - self._last_line >= SECONDS_BETWEEN_LINES or self._done == self._iterations
        if due and not self._console.is_terminal:
            self._last_line = now
            left = self._iterations - self._done
            known = f", {(now - since) / (self._done - done) * left:.0f} s left" if self._done > done else ""
            self.say(f"iteration {self._done}/{self._iterations}: {figures}{known}")
