"""`pecjax check`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from pecjax.commands.drawing import draw_map
from pecjax.commands.options import Strings
from pecjax.envs.rooms.settings import Rooms


@dataclass(frozen=True)
class Check:
    """Checks a map and its coordinates, and draws them.

    Attributes:
        scene: maps with their drone in MJCF, files or folders. (default: the paper's six rooms)
        coordinates: the paper's set 1 or 2, or a file of lines 'start_x, start_y, goal_x, goal_y'.
        out: where the picture goes, as .pdf and .png.
    """

    scene: Strings = None
    coordinates: str = "1"
    out: Path = Path("check")

    def run(self) -> None:
        """Checks, then draws."""
        task = Rooms(table=self.coordinates, maps=self.scene or ())
        made, world = task.make()
        for line in task.notices(made, world):
            print(f"pecjax: notice: {line}", file=sys.stderr)
        scenes, table = task.scenes(), task.configurations()
        paths = draw_map(scenes[0], table, self.out)
        walls = len(scenes[0].map.names)
        maps = f"{walls} walls" if len(scenes) == 1 else f"{len(scenes)} maps, the first of {walls} walls"
        print(
            f"{maps}, {table.size} configurations: every one can be flown by a "
            f"drone of radius {made.vehicle.radius:g} m; drawn to {' and '.join(map(str, paths))}"
        )
