"""`pecjax figures`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from pecjax.commands.drawing import draw


@dataclass(frozen=True)
class Figures:
    """Draws the figures of a run or a study again, from its plain files.

    Attributes:
        folder: the run's or the study's.
    """

    folder: tyro.conf.Positional[Path]

    def run(self) -> None:
        """Draws and names the files."""
        for path in draw(self.folder):
            print(path)
