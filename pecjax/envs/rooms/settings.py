"""Settings of the rooms: which maps, which configurations, which rules."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from pecjax.envs.configuration_files import table_text
from pecjax.envs.rooms.config import Configurations, load_coordinates
from pecjax.envs.rooms.maps import make_bank
from pecjax.envs.rooms.notices import map_notices
from pecjax.envs.rooms.scene import Scene, default_scene_path, load_scene
from pecjax.envs.rooms.task import NavigationSettings, RoomsParams, RoomsTask
from pecjax.envs.rooms.validity import check_configurations
from pecjax.envs.task import Task, TaskSettings, World
from pecjax.errors import InputError

TABLE_FILE, MAP_FILE, MAPS_FOLDER = "coordinates.csv", "scene.xml", "maps"  # in a run's folder


@dataclass(frozen=True)
class Rooms(NavigationSettings, TaskSettings):
    """Flying through rooms (see `NavigationSettings` for its rules).

    Attributes:
        table: the paper's set 1 or 2, or a file of configurations.
        maps: MJCF files, or folders of them, in the order that a table counts them in; the paper's six
            rooms where there are none.
        resolution: (width, height) of the depth image; None for what the first map's camera says.
    """

    # For tasks of one's own that extend this one: see `examples/own_axis.py`.
    task_kind: ClassVar[type[RoomsTask]] = RoomsTask
    configurations_kind: ClassVar[type[Configurations]] = Configurations

    table: str = "1"
    maps: tuple[str, ...] = ()
    resolution: tuple[int, int] | None = None

    def make(self) -> tuple[RoomsTask, World]:
        """Reads maps and configurations, and makes sure that they can be flown.

        Raises:
            InputError: a file that is not there or is wrong, maps whose drones differ, a timestep that
                does not fit, or a configuration that cannot be flown.
        """
        table, scenes = self.configurations(), self.scenes()
        task = self.task_kind(scenes[0].vehicle, self)
        check_configurations(
            [scene.map for scene in scenes], table, task.vehicle.radius, self.flight_height, self.table
        )
        return task, World(RoomsParams(make_bank([scene.map for scene in scenes])), table)

    def scenes(self) -> list[Scene]:
        """The maps in their order, all with the drone of the first; read once.

        Raises:
            InputError: a file that is not there or is wrong, or another drone.
        """
        return self._scenes

    @functools.cached_property
    def _scenes(self) -> list[Scene]:
        paths = self._paths()
        first = load_scene(paths[0], self.resolution)
        return [first, *(load_scene(path, self.resolution, first.vehicle) for path in paths[1:])]

    def _paths(self) -> list[Path]:
        found: list[Path] = []
        for name in map(Path, self.maps):
            inside = sorted(name.glob("*.xml")) if name.is_dir() else [name]
            if not inside:
                raise InputError(f"{name}: no MJCF file (*.xml) in this folder; give a folder of maps")
            found.extend(inside)
        return found or [default_scene_path()]

    def files(self) -> dict[str, str]:
        """Maps and table, as they were read."""
        texts = [scene.text for scene in self.scenes()]
        width = len(str(len(texts) - 1))
        names = (
            [f"{MAPS_FOLDER}/{n:0{width}}.xml" for n in range(len(texts))] if len(texts) > 1 else [MAP_FILE]
        )
        return dict(zip(names, texts, strict=True)) | {TABLE_FILE: table_text(self.configurations())}

    def configurations(self) -> Configurations:
        """The table."""
        return load_coordinates(self.table, self.configurations_kind)

    def kept_in(self, folder: Path) -> Rooms:
        """The same settings, but reading the files that are kept in `folder`."""
        several = (folder / MAPS_FOLDER).is_dir()
        kept = folder / (MAPS_FOLDER if several else MAP_FILE)
        return dataclasses.replace(self, table=str(folder / TABLE_FILE), maps=(str(kept),))

    def notices(self, task: Task, world: World) -> tuple[str, ...]:
        """A line for each thing that is allowed, but seldom meant."""
        return map_notices([scene.map for scene in self.scenes()], world.table, task.vehicle, self)
