"""The sink that logs to Weights & Biases."""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pecjax import settings_tree
from pecjax.errors import InputError
from pecjax.runtime.distributed import primary_only
from pecjax.runtime.extras import require
from pecjax.storage.tables import Row
from pecjax.training.kinds import run_label
from pecjax.training.run_directory import RunDirectory
from pecjax.training.sinks.base import Sink
from pecjax.training.sinks.history import POSITION, past_rows, scalars


class WandB(Sink):
    """Logs every column of both tables against environment steps, and the settings as the run's config.

    W&B's own step is the iteration. The run's id is kept in its folder: a run that resumes goes on under
    the same id, and rows of iterations that W&B has already are not sent again. Since a training resumes bit
    for bit, what W&B has is what they would be. Offline, W&B has nothing yet: each session writes all rows
    from the beginning.
    """

    def __init__(self, project: str = "pecjax", **options: Any) -> None:
        """Names the project.

        Args:
            options: of `wandb.init`, such as entity, group, tags, notes or mode.
        """
        self._options = {"project": project, **options}

    @primary_only
    def check(self) -> None:
        """Raises InputError where wandb is missing, or nobody is logged in and W&B is not offline."""
        wandb: Any = require("wandb", extra="wandb")
        if (self._options.get("mode") or os.environ.get("WANDB_MODE", "online")) != "online":
            return
        try:
            wandb.login()
        except wandb.Error as error:
            raise _in_one_line(error) from error

    @primary_only
    def open(self, runs: Sequence[str], iteration: int) -> None:
        """Starts the run, or goes on with it, and sends the rows that it already has and W&B lacks.

        Raises:
            InputError: W&B refuses, or cannot be reached.
        """
        import wandb

        folder = Path(runs[0])
        settings = RunDirectory(folder).settings()
        known = {
            "id": _run_id(folder),
            "resume": "allow",
            "name": run_label(settings),
            "config": settings_tree.to_json(settings),
            "dir": str(folder),
        }
        try:
            self._run = wandb.init(**{**known, **self._options})
        except wandb.Error as error:
            raise _in_one_line(error) from error
        self._run.define_metric("env_steps", hidden=True)
        self._run.define_metric("*", step_metric="env_steps")
        self._first = self._run.step  # of those that W&B lacks
        for table, row in past_rows(folder):
            self._log(table, row)

    @primary_only
    def rows(self, table: str, rows: Sequence[Row]) -> None:
        """Logs the first run's row."""
        self._log(table, rows[0])

    def _log(self, table: str, row: Row) -> None:
        if row["iteration"] >= self._first:
            position = {name: row[name] for name in POSITION}
            self._run.log(position | scalars(table, row), step=row["iteration"])

    @primary_only
    def close(self) -> None:
        """Ends the run: as failed, where an exception has ended the training."""
        self._run.finish(exit_code=int(sys.exception() is not None))


def _run_id(folder: Path) -> str:
    """The id of the run in this folder, made when there is none."""
    path = folder / "wandb" / "run_id"
    if not path.is_file():
        path.parent.mkdir(exist_ok=True)
        path.write_text(secrets.token_hex(4))
    return path.read_text()


def _in_one_line(error: Exception) -> InputError:
    reason = str(error).rstrip(".")
    return InputError(
        f"wandb: {reason}; with WANDB_MODE=offline no login is needed, `wandb sync` uploads later"
    )
