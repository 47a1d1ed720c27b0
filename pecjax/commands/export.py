"""`pecjax export`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from pecjax.commands.options import Option
from pecjax.export.files import export_policy


@dataclass(frozen=True)
class Export:
    """Writes a run's policy for other programs, and all that they need to know as JSON beside it.

    The JSON has the same name, but ends in .json. docs/export.md explains both, and flies one without JAX.

    Attributes:
        folder: the run's folder.
        format: onnx, or jax (StableHLO that `jax.export.deserialize` reads).
        out: the file; what is there is replaced. (default: policy.onnx or policy_jax.bin in the run's folder)
        checkpoint: the iteration it was saved at. (default: the newest)
    """

    folder: tyro.conf.Positional[Path]
    format: str = "onnx"
    out: Option[Path] = None
    checkpoint: Option[int] = None

    def run(self) -> None:
        """Writes and names the files."""
        for path in export_policy(self.folder, self.format, self.out, self.checkpoint):
            print(path)
