"""The sink that calls a function of one's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pecjax.runtime.distributed import primary_only
from pecjax.storage.tables import Row
from pecjax.training.sinks.base import Sink


class Callback(Sink):
    """Calls a function with every row; what it raises ends the training.

    Example:
        pecjax.train(settings, sinks=[pecjax.sinks.Callback(lambda table, rows: print(table, rows[0]))])
    """

    def __init__(self, on_rows: Callable[[str, Sequence[Row]], None]) -> None:
        """Takes the function.

        Args:
            on_rows: (table, rows), as `Sink.rows` is called; where several processes share a training,
                the first calls it.
        """
        self._on_rows = on_rows

    @primary_only
    def rows(self, table: str, rows: Sequence[Row]) -> None:
        """Calls the function."""
        self._on_rows(table, rows)
