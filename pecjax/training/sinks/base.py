"""Sinks: listeners to the training loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pecjax.storage.tables import Row


class Sink:
    """A listener to the training loop: extend it and override the methods you need.

    Where several processes share a training, each has sinks, and only the first should write.
    """

    def check(self) -> None:
        """Before anything is written: raises InputError where the sink cannot do its work."""

    def open(self, runs: Sequence[str], iteration: int) -> None:
        """The runs start, or resume after so many iterations.

        Args:
            runs: the folder of a single run, whose config.json and tables up to here are there already; or
                the names of the runs of a study.
        """

    def rows(self, table: str, rows: Sequence[Row]) -> None:
        """One row of each run: of the table `metrics` after every iteration, of `evaluation` when due."""

    def arrays(self, name: str, iteration: int, arrays: Sequence[dict[str, Any]]) -> None:
        """Arrays of each run: `configurations` (see `rows.configuration_arrays`) or `episodes`, when due."""

    def close(self) -> None:
        """The loop has ended, or was stopped."""


class Sinks(Sink):
    """Several sinks as one, open while it is entered."""

    def __init__(self, sinks: Sequence[Sink], runs: Sequence[str], iteration: int) -> None:
        """See `Sink.open`."""
        self._sinks = sinks
        self._started = runs, iteration

    def __enter__(self) -> Sinks:
        self.open(*self._started)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self, runs: Sequence[str], iteration: int) -> None:
        """Opens all."""
        for sink in self._sinks:
            sink.open(runs, iteration)

    def rows(self, table: str, rows: Sequence[Row]) -> None:
        """Tells all."""
        for sink in self._sinks:
            sink.rows(table, rows)

    def arrays(self, name: str, iteration: int, arrays: Sequence[dict[str, Any]]) -> None:
        """Tells all."""
        for sink in self._sinks:
            sink.arrays(name, iteration, arrays)

    def close(self) -> None:
        """Closes all."""
        for sink in self._sinks:
            sink.close()
