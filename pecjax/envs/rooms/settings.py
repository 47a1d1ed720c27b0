"""Settings of the rooms: which maps and configurations, or which space, by which rules."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from pecjax.envs.axes import axes_of, fill
from pecjax.envs.configuration_files import table_text
from pecjax.envs.rooms.config import Configurations, load_coordinates
from pecjax.envs.rooms.map_file import Map, map_of
from pecjax.envs.rooms.maps import make_bank
from pecjax.envs.rooms.notices import map_notices
from pecjax.envs.rooms.path_fields import find_goals, make_path_fields
from pecjax.envs.rooms.plans.plans import RADIUS
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.scene import Scene, default_scene_path, has_six_rooms, load_scene
from pecjax.envs.rooms.spaces.space import Space
from pecjax.envs.rooms.spaces.space_file import read_space, space_path
from pecjax.envs.rooms.task import RoomsParams, RoomsTask
from pecjax.envs.rooms.validity import check_configurations
from pecjax.envs.task import EvalSet, Task, TaskSettings, World
from pecjax.errors import InputError

# In a run's folder.
TABLE_FILE, MAP_FILE, MAPS_FOLDER, SPACE_FILE = "coordinates.csv", "scene.xml", "maps", "space.npz"


@dataclass(frozen=True)
class Rooms(NavigationSettings, TaskSettings):
    """Flying through rooms (see `NavigationSettings` for its rules).

    Attributes:
        table: the paper's set 1 or 2, or a file of configurations; None for the starts and goals that the
            maps mark, or for set 1 where they mark none.
        maps: MJCF files, folders of them, or text plans, in the order that a table counts them in; the
            paper's six rooms where there are none.
        approximate: metres by which boxes may reach beyond the shapes in the maps that they stand for;
            None to have shapes other than boxes and planes refused.
        space: a named space (`pecjax spaces`), or the file of one, in place of a table: its training part is
            flown, and evaluations are of the part that is held out. Maps then say which drone flies, and
            where, if the space has no maps of its own.
        resolution: (width, height) of the depth image; None for what the first map's camera says.
        by_mjx: whether MJX takes the physics steps even of a drone that only gravity and its rotors act on;
            otherwise those have a closed form, which is many times as fast and equal but for rounding.
        critic_paths: whether a critic is told, in training alone, how long the shortest path to the goal is
            and where it leads, if it is a PPO's that may be told (`NetworkSettings.critic`). No policy is
            shown it. The paths of 10,000 maps take about half a minute.
    """

    # For tasks of one's own that extend this one: see `examples/own_axis.py`.
    task_kind: ClassVar[type[RoomsTask]] = RoomsTask
    configurations_kind: ClassVar[type[Configurations]] = Configurations

    table: str | None = None
    maps: tuple[str, ...] = ()
    approximate: float | None = None
    space: str | None = None
    resolution: tuple[int, int] | None = None
    by_mjx: bool = False
    critic_paths: bool = False

    def make(self) -> tuple[RoomsTask, World]:
        """Reads maps and configurations, and makes sure that they can be flown.

        Raises:
            InputError: a file that is not there or is wrong, maps whose drones differ, a timestep that
                does not fit, a configuration that cannot be flown, or too many paths for a critic.
        """
        table, scenes, space = self.configurations(), self.scenes(), self.named_space
        if space is not None and len(scenes) > 1:
            raise InputError(
                f"space '{self.space}' takes one map, whose drone is flown; give one with --scene, not "
                f"{len(scenes)}"
            )
        maps = [scene.map for scene in scenes]
        bank = None if space is None else space.maps
        task = self.task_kind(
            scenes[0].vehicle,
            self,
            objectives=table.objective is not None,
            one_map=len(maps if bank is None else bank.bounds) == 1,
            critic_paths=self.critic_paths,
        )
        if space is None or (bank is None and self.maps):
            source = self.table if space is None else None
            try:
                for one in (table,) if space is None else (table, space.held_out.table):
                    check_configurations(maps, one, task.vehicle.radius, self.flight_height, source)
            except InputError as error:
                raise InputError(f"{error}{self._hint(maps)}") from None
        if bank is not None and task.vehicle.radius > RADIUS:
            raise InputError(
                f"the drone has a radius of {task.vehicle.radius:g} m; the maps of space '{self.space}' are "
                f"made for {RADIUS:g} m at most"
            )
        bank = make_bank(maps) if bank is None else bank
        if self.critic_paths:
            find_goals(bank.bounds, [table])
        return task, World(RoomsParams(bank), table)

    def for_training(self, world: World) -> World:
        """The world with the paths to its goals, where critics are told of them."""
        return self.with_paths(world, world.table) if self.critic_paths else world

    def with_paths(self, world: World, *tables: Configurations) -> World:
        """The world with the paths to the goals of the tables, see `make_path_fields`."""
        radius, height = self.scenes()[0].vehicle.radius, self.flight_height
        paths = make_path_fields(world.params.bank, tables, radius=radius, flight_height=height)
        return world._replace(params=world.params._replace(paths=paths))

    def _hint(self, maps: Sequence[Map]) -> str:
        """What else to say of a configuration that cannot be flown: the paper's do not fit other maps."""
        marked = self.table is None and _marked(maps) is not None
        if self.space is not None or not self.maps or marked or self.table not in (None, "1", "2"):
            return ""
        return (
            " (these are the paper's configurations; give your own with --coordinates, or mark starts and "
            "goals in the map)"
        )

    @property
    def table_name(self) -> str:
        """What people know its configurations by, where it is of no space."""
        return self.table or (self.maps[0] if self.maps else "1")

    @functools.cached_property
    def named_space(self) -> Space | None:
        """The space, whose configurations were checked where it was made; None where there is none."""
        if self.space is None:
            return None
        if self.table is not None:
            raise InputError(f"space '{self.space}' has configurations of its own; leave out --coordinates")
        if self.flight_height != NavigationSettings.flight_height:
            raise InputError(
                f"flight-height is {self.flight_height} m; the spaces are made for "
                f"{NavigationSettings.flight_height} m, leave it out"
            )
        return read_space(space_path(self.space))

    def eval_set(self, world: World, split: str = "held-out") -> EvalSet:
        """All configurations of a table; of a space those that are held out, or those of its other part."""
        space = self.named_space
        if space is None:
            return EvalSet(world.table)
        part, apart = space.part(split), len(space.groups) > 1
        # Where the goal's radius begins the way is done. In another map than the six rooms it is not known.
        six_rooms = space.maps is not None or not self.maps or has_six_rooms(self.scenes()[0])
        shortest = np.maximum(part.shortest - self.goal_radius, 0) if six_rooms else None
        table = self._of_own_kind(part.table)
        held_out = split == "held-out"
        return EvalSet(table, space.groups, part.group if apart else None, shortest, held_out)

    def _of_own_kind(self, table: Configurations) -> Configurations:
        known = {name: getattr(table, name) for name in axes_of(Configurations)}
        return fill(self.configurations_kind(**known))

    def scene(self, number: int) -> Scene:
        """One of the maps, with the drone."""
        bank = None if self.named_space is None else self.named_space.maps
        if bank is None:
            return self.scenes()[number]
        return dataclasses.replace(self.scenes()[0], map=map_of(bank, number))

    def scenes(self) -> list[Scene]:
        """The maps from files in their order, all with the drone of the first; read once.

        Raises:
            InputError: a file that is not there or is wrong, or another drone.
        """
        return self._scenes

    @functools.cached_property
    def _scenes(self) -> list[Scene]:
        paths = self._paths()
        first = load_scene(paths[0], self.resolution, approximate=self.approximate, by_mjx=self.by_mjx)
        others = (load_scene(path, self.resolution, first.vehicle, self.approximate) for path in paths[1:])
        return [first, *others]

    def _paths(self) -> list[Path]:
        found: list[Path] = []
        for name in map(Path, self.maps):
            inside = sorted(name.glob("*.xml")) if name.is_dir() else [name]
            if not inside:
                raise InputError(f"{name}: no MJCF file (*.xml) in this folder; give a folder of maps")
            found.extend(inside)
        return found or [default_scene_path()]

    def files(self) -> dict[str, bytes]:
        """Maps and table, as they were read, or the space."""
        texts = [scene.text for scene in self.scenes()]
        if self.space is not None:
            return {SPACE_FILE: space_path(self.space).read_bytes(), MAP_FILE: texts[0].encode()}
        width = len(str(len(texts) - 1))
        names = (
            [f"{MAPS_FOLDER}/{n:0{width}}.xml" for n in range(len(texts))] if len(texts) > 1 else [MAP_FILE]
        )
        kept = dict(zip(names, texts, strict=True)) | {TABLE_FILE: table_text(self.configurations())}
        return {name: text.encode() for name, text in kept.items()}

    def configurations(self) -> Configurations:
        """The table that is trained in."""
        if self.named_space is not None:
            return self._of_own_kind(self.named_space.train.table)
        if self.table is not None:
            return load_coordinates(self.table, self.configurations_kind)
        marked = _marked([scene.map for scene in self.scenes()]) if self.maps else None
        return (
            load_coordinates("1", self.configurations_kind) if marked is None else self._of_own_kind(marked)
        )

    def kept_in(self, folder: Path) -> Rooms:
        """The same settings, but reading the files that are kept in `folder`."""
        if self.space is not None:
            return dataclasses.replace(self, space=str(folder / SPACE_FILE), maps=(str(folder / MAP_FILE),))
        several = (folder / MAPS_FOLDER).is_dir()
        kept = folder / (MAPS_FOLDER if several else MAP_FILE)
        return dataclasses.replace(self, table=str(folder / TABLE_FILE), maps=(str(kept),))

    def notices(self, task: Task, world: World) -> tuple[str, ...]:
        """A line for each thing that is allowed, but seldom meant."""
        if self.space is not None:
            return ()
        told = [
            f"{path}: {line}"
            for path, scene in zip(self._paths(), self.scenes(), strict=True)
            for line in scene.notices
        ]
        return (*told, *map_notices([scene.map for scene in self.scenes()], world.table, task.vehicle, self))


def _marked(maps: Sequence[Map]) -> Configurations | None:
    """From every start to every goal that a map marks, map by map; None where none marks any."""
    rows = [
        (start, goal, number)
        for number, one in enumerate(maps)
        for start, goal in itertools.product(one.starts, one.goals)
    ]
    if not rows:
        return None
    start, goal, map_id = (np.array(column) for column in zip(*rows, strict=True))
    return fill(Configurations(start.astype(np.float32), goal.astype(np.float32), map_id.astype(np.int32)))
