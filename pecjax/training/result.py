"""Training from Python: from settings to a policy and the figures of its training."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pecjax.storage.tables import Row
from pecjax.training import train as training
from pecjax.training.load import Trained, open_run
from pecjax.training.settings import RunSettings
from pecjax.training.sinks import Sink


class Result(NamedTuple):
    """The result of a training.

    Attributes:
        summary: the content of summary.json.
        metrics, evaluation: the rows of both tables.
        trained: the run with its last learner; `trained.policy()` is its policy.
    """

    summary: dict[str, Any]
    metrics: list[Row]
    evaluation: list[Row]
    trained: Trained


class _Rows(Sink):
    def __init__(self) -> None:
        self.tables: dict[str, list[Row]] = {"metrics": [], "evaluation": []}

    def rows(self, table: str, rows: Sequence[Row]) -> None:
        self.tables[table].extend(rows)


def train(
    settings: RunSettings = RunSettings(),
    out: str | Path | None = None,
    *,
    devices: int | None = None,
    sinks: Sequence[Sink] = (),
) -> Result:
    """Trains a policy.

    Example:
        settings = pecjax.set_path(pecjax.RunSettings(), "sampler.alpha", 0.3)
        result = pecjax.train(settings, "runs/my_run")
        act = result.trained.policy()

    Args:
        out: the run's folder, which must be empty or not exist; None keeps no files.
        devices: how many devices share the environments; None for all that divide them.
        sinks: listeners to the loop.

    Raises:
        InputError: the settings cannot be run.
        StoppedError, DivergedError: see `pecjax.training.train.train`.
    """
    rows = _Rows()
    with tempfile.TemporaryDirectory() as elsewhere:
        folder = Path(elsewhere) / "run" if out is None else Path(out)
        summary = training.train(settings, folder, devices, [rows, *sinks])
        return Result(summary, **rows.tables, trained=open_run(folder))
