"""`pecjax new-map`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from pecjax.envs.rooms.new_map import new_mjcf, new_text_plan
from pecjax.errors import InputError
from pecjax.storage.files import replace_file, writing

_KINDS = {".xml": new_mjcf, ".txt": new_text_plan}


@dataclass(frozen=True)
class NewMap:
    """Writes a map of three rooms, to be changed with any editor.

    Attributes:
        path: the new file: .xml for MJCF with a drone, .txt for a floor plan drawn with # and .
    """

    path: tyro.conf.Positional[Path]

    def run(self) -> None:
        """Writes it, and says what to type next."""
        if self.path.suffix not in _KINDS:
            raise InputError(f"{self.path}: a map ends in .xml or .txt; give such a name")
        if self.path.exists():
            raise InputError(f"{self.path}: is there already; give another name")
        with writing(self.path, "give another name"):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(self.path, _KINDS[self.path.suffix]())
        print(
            f"{self.path}: three rooms, with 2 starts and 2 goals; change it with any editor, then\n"
            f"  pecjax check --scene {self.path}\n"
            f"  pecjax train --scene {self.path}"
        )
