"""The sink that writes for TensorBoard."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pecjax import settings_tree
from pecjax.runtime.distributed import primary_only
from pecjax.runtime.extras import require
from pecjax.storage.tables import Row
from pecjax.training.kinds import run_label
from pecjax.training.run_directory import RunDirectory
from pecjax.training.sinks.base import Sink
from pecjax.training.sinks.history import past_rows, scalars

_SHOWN_BESIDE_SETTINGS = ("evaluation/goal_ratio", "evaluation/mean_return")


class TensorBoard(Sink):
    """Writes every column of both tables against environment steps, and the settings as hyperparameters.

    A run that resumes declares all that was written before void, and writes it anew from its tables: what
    the resume has rolled back is gone.
    """

    def __init__(self, folder: str | Path | None = None) -> None:
        """Names the folder of the event files, one for each run.

        Args:
            folder: `tensorboard/` in the run's folder when None.
        """
        self._folder = folder

    @primary_only
    def check(self) -> None:
        """Raises InputError where tensorboardX is missing."""
        require("tensorboardX", extra="tensorboard")

    @primary_only
    def open(self, runs: Sequence[str], iteration: int) -> None:
        """Writes settings and name, and the rows that the run already has."""
        from tensorboardX import SummaryWriter
        from tensorboardX.summary import hparams

        run = Path(runs[0])
        settings = RunDirectory(run).settings()
        folder = self._folder or run / "tensorboard"
        self._writer: Any = SummaryWriter(str(folder), purge_step=0 if iteration else None)
        self._writer.add_text("run", run_label(settings), 0)
        leaves = {
            path: value if isinstance(value, bool | int | float | str) else str(value)
            for path, value in settings_tree.leaves(settings)
        }
        # `SummaryWriter.add_hparams` would make a second run of them.
        start = hparams(leaves, dict.fromkeys(_SHOWN_BESIDE_SETTINGS))[:2]
        for summary in start:
            self._writer.file_writer.add_summary(summary)
        for table, row in past_rows(run):
            self._write(table, row)

    @primary_only
    def rows(self, table: str, rows: Sequence[Row]) -> None:
        """Writes the first run's row."""
        self._write(table, rows[0])

    def _write(self, table: str, row: Row) -> None:
        steps = row["env_steps"]
        if table == "metrics":
            self._writer.add_scalar("iteration", row["iteration"], steps)
        for name, value in scalars(table, row).items():
            self._writer.add_scalar(name, value, steps)

    @primary_only
    def close(self) -> None:
        """Writes what is left."""
        self._writer.close()
