"""`pecjax check`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from pecjax.commands.drawing import draw_map
from pecjax.commands.options import Option
from pecjax.envs.rooms.notices import world_notices
from pecjax.training.build import load_world
from pecjax.training.presets import RunSettings


@dataclass(frozen=True)
class Check:
    """Checks a map and its coordinates, and draws them.

    Attributes:
        scene: a map and drone in MJCF. (default: the paper's six rooms)
        coordinates: the paper's set 1 or 2, or a file of lines 'start_x, start_y, goal_x, goal_y'.
        out: where the picture goes, as .png and .svg.
    """

    scene: Option[Path] = None
    coordinates: str = "1"
    out: Path = Path("check")

    def run(self) -> None:
        """Checks, then draws."""
        scene_name = None if self.scene is None else str(self.scene)
        _, scene, table = load_world(RunSettings(scene=scene_name, coordinates=self.coordinates))
        for line in world_notices(scene, table):
            print(f"pecjax: notice: {line}", file=sys.stderr)
        stem = self.out.with_suffix("") if self.out.suffix in (".png", ".svg") else self.out
        paths = draw_map(scene, table, stem)
        print(
            f"{len(scene.wall_names)} walls, {table.size} configurations: every one can be flown by a "
            f"drone of radius {scene.drone_radius:g} m; drawn to {' and '.join(map(str, paths))}"
        )
