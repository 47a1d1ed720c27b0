"""The sink that writes a run's folder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pecjax.storage.tables import Row
from pecjax.training.loop import Clock
from pecjax.training.run_directory import RunDirectory
from pecjax.training.sinks import Sink


class RunFiles(Sink):
    """metrics.csv and evaluation.csv row by row, `configurations/` and `episodes/` by iteration."""

    def __init__(self, directory: RunDirectory, clock: Clock) -> None:
        """Writes into a directory that has been created."""
        self._directory = directory
        self._clock = clock

    def rows(self, table: str, rows: Sequence[Row]) -> None:
        """Adds a row to the table; those of metrics.csv have the seconds so far."""
        (row,) = rows
        if table == "metrics":
            steps = {name: row[name] for name in ("iteration", "env_steps")}
            row = steps | {"seconds": round(self._clock.seconds(), 3)} | row
        self._directory.append(f"{table}.csv", [row])

    def arrays(self, name: str, iteration: int, arrays: Sequence[dict[str, Any]]) -> None:
        """Keeps the arrays."""
        self._directory.write_arrays(name, iteration, arrays[0])
