"""Scene: a map and its drone, read from an MJCF file and checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from pecjax.envs.rooms.default_drone import default_scene_path
from pecjax.envs.rooms.map_file import Map, read_map
from pecjax.envs.rooms.maps import Walls
from pecjax.envs.rooms.mjcf_file import read_map_file
from pecjax.envs.rooms.vehicle import Vehicle, set_options
from pecjax.envs.rooms.vehicle_file import MAX_PIXELS, find_drone, read_vehicle
from pecjax.errors import InputError


@dataclass(frozen=True)
class Scene:
    """Everything that comes from the MJCF file.

    Attributes:
        model: the compiled MuJoCo model, with the options that pecjax runs it with.
        vehicle: the drone.
        map: the walls.
        text: the whole map as MJCF, as `mjcf_file.MapFile` has it.
        notices: what was added or put in the place of what the file says, for people.
    """

    model: mujoco.MjModel
    vehicle: Vehicle
    map: Map
    text: str
    notices: tuple[str, ...] = ()

    @property
    def wall_lower(self) -> np.ndarray:
        """(W, 3) m, the walls' lower corners."""
        return self.map.lower

    @property
    def wall_upper(self) -> np.ndarray:
        """(W, 3) m, the walls' upper corners."""
        return self.map.upper

    @property
    def walls(self) -> Walls:
        """The walls' corners, as clearance and depth take them."""
        return Walls(self.map.lower, self.map.upper)

    @property
    def drone_radius(self) -> float:
        """Radius (m) of the drone's collision sphere."""
        return self.vehicle.radius


def load_scene(
    path: str | Path | None = None,
    resolution: tuple[int, int] | None = None,
    like: Vehicle | None = None,
    approximate: float | None = None,
    by_mjx: bool = False,
) -> Scene:
    """Reads a map and its drone from an MJCF file or a text plan.

    An MJCF file must hold one body named `drone` with a free joint, a collision sphere, a camera and
    at least four site actuators, or nothing that moves: then the drone of the six rooms is added. Every
    other geom that can collide must be a box or a plane along the axes and is a wall: it is both hit and
    seen. The numeric `depth_range` (near, far) is optional. `docs/maps.md` has the details.

    Args:
        path: the MJCF file or, as .txt, the text plan; the six rooms of the paper when None.
        resolution: (width, height) in pixels of the depth image, instead of the file's.
        like: the drone that it must have, of another map of the same task.
        approximate: m; other shapes then become boxes that hold them and reach at most so far beyond.
        by_mjx: whether MJX takes the physics steps even of a drone that only gravity and its rotors act on,
            whose steps are otherwise taken in closed form.

    Raises:
        InputError: the file is missing, is not MJCF, or lacks one of the above; or a resolution of too
            many pixels or none.
    """
    if resolution is not None:
        width, height = resolution
        if min(width, height) < 1 or width * height > MAX_PIXELS:
            raise InputError(f"resolution is {width}×{height}; 1 to {MAX_PIXELS:,} pixels are possible")
    map_file = read_map_file(default_scene_path() if path is None else Path(path), approximate)
    model = map_file.model
    drone = find_drone(map_file)
    set_options(model)
    if resolution is not None:
        model.cam_resolution[:] = resolution
    walls = read_map(map_file, drone)
    return Scene(model, read_vehicle(map_file, drone, like, by_mjx), walls, map_file.text, map_file.notices)


def has_six_rooms(scene: Scene) -> bool:
    """Whether its walls are those of the paper's six rooms."""
    own, rooms = scene.map, load_scene().map
    return np.array_equal(own.lower, rooms.lower) and np.array_equal(own.upper, rooms.upper)
