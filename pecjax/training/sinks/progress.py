"""The sink that a person sees: a progress bar, or a line every few seconds."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress as Bar, TextColumn, TimeRemainingColumn

from pecjax.runtime.distributed import is_primary
from pecjax.storage.tables import Row
from pecjax.training.sinks.base import Sink

SECONDS_BETWEEN_LINES = 10.0  # where there is no terminal to draw a bar on


class Progress(Sink):
    """A progress bar on a terminal, otherwise a line every few seconds; both on stderr."""

    def __init__(self, iterations: int, episodes: str = "") -> None:
        """Prepares a bar of so many iterations; it shows with the first row.

        Args:
            episodes: of an evaluation, in words, where each is to have a line.
        """
        self._console = Console(stderr=True, highlight=False, soft_wrap=True, quiet=not is_primary())
        # Rich takes FORCE_COLOR for a terminal, which notebooks and many a CI set.
        self._draws = self._console.is_terminal and self._console.file.isatty()
        self._iterations = iterations
        self._episodes = episodes
        self._done = 0
        self._since: tuple[float, int] | None = None  # when the first row came, and what was done then
        self._pace, self._figures = 0.0, ""  # iterations a second, and what is shown beside the number
        self._last_line = -SECONDS_BETWEEN_LINES
        self._bar = Bar(
            TextColumn("training"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=self._console,
            disable=self._console.quiet or not self._draws,
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
        """Counts some iterations as done, without using them for the pace."""
        self._done += iterations
        if self._since:
            since, before = self._since
            self._since = since, before + iterations

    def rows(self, table: str, rows: Sequence[Row]) -> None:
        """Advances by an iteration of each run, or prints the line of an evaluation."""
        ratios = [row["goal_ratio"] for row in rows]
        if table == "metrics":
            known = [ratio for ratio in ratios if not np.isnan(ratio)]
            episodes = sum(row["episodes"] for row in rows)
            ratio = f"{np.mean(known):.3f} of {episodes} episode(s)" if known else "not known yet"
            self._advance(
                len(rows), f"training goal ratio {ratio}", rows[0]["env_steps"] / rows[0]["iteration"]
            )
        elif self._episodes:
            self.say(
                f"iteration {rows[0]['iteration']}: goal ratio {ratios[0]:.3f} over "
                f"{self._episodes} of a uniform draw"
            )
        # The rows of a study come many at once, before an evaluation; only the last of them tells the pace.
        if table == "metrics" if self._episodes else table == "evaluation":
            self._say_if_due()

    def _advance(self, iterations: int, figures: str, steps: float) -> None:
        """Shows that so many more iterations, of so many steps each, are done."""
        self._done += iterations
        now = time.monotonic()
        self._since = since, before = self._since or (now, self._done)
        self._pace = (self._done - before) / max(now - since, 1e-6)
        self._figures = figures + (f", {steps * self._pace:,.0f} steps/s" if self._pace else "")
        self._bar.start()
        self._bar.update(self._task, completed=self._done, figures=self._figures)

    def _say_if_due(self) -> None:
        """Prints a line where there is no bar, and it is time for one."""
        now = time.monotonic()
        due = now - self._last_line >= SECONDS_BETWEEN_LINES or self._done == self._iterations
        if due and not self._draws:
            self._last_line = now
            left = f", {(self._iterations - self._done) / self._pace:.0f} s left" if self._pace else ""
            self.say(f"iteration {self._done}/{self._iterations}: {self._figures}{left}")
