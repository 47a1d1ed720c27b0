"""`pecjax check`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pecjax.commands.drawing import draw_map
from pecjax.commands.options import Option
from pecjax.world.coordinates import check_coordinates, load_coordinates
from pecjax.world.navigation import NavigationSettings
from pecjax.world.scene import load_scene


@dataclass(frozen=True)
class Check:
    """Checks a map and its coordinates, and draws them.

    Attributes:
        scene: a map and drone in MJCF. (default: the paper's six rooms)
        coordinates: the paper's set 1 or 2, or a file of lines 'x, y, x, y'.
        out: where the picture goes, as .png and .svg.
    """

    scene: Option[Path] = None
    coordinates: str = "1"
    out: Path = Path("check")

    def run(self) -> None:
        """Checks, then draws."""
        scene = load_scene(self.scene)
        table = load_coordinates(self.coordinates)
        check_coordinates(scene, table, flight_height=NavigationSettings().flight_height)
        stem = self.out.with_suffix("") if self.out.suffix in (".png", ".svg") else self.out
        paths = draw_map(scene, table, stem)
        print(
            f"{len(scene.wall_names)} walls, {table.size} configurations: every one can be flown by a "
            f"drone of radius {scene.drone_radius:g} m; drawn to {' and '.join(map(str, paths))}"
        )
