"""The default drone: that of the six rooms, for maps of walls alone."""

from __future__ import annotations

from pathlib import Path

import mujoco

_PREFIX = "default_"  # of the names of its parts, so that they meet none of the map's
_OPTIONS = ("jacobian", "integrator", "disableflags", "enableflags", "gravity", "timestep")


def default_scene_path() -> Path:
    """The map of six rooms: inside the installed package, or in the checkout beside it."""
    package = Path(__file__).resolve().parents[2]
    shipped = package / "assets" / "rooms.xml"
    return shipped if shipped.exists() else package.parent / "assets" / "rooms.xml"


def add_default_drone(spec: mujoco.MjSpec) -> None:
    """Gives a map of walls alone the drone of the six rooms, in place.

    Its timestep comes with it where the map has none of its own, and its range of depth.
    """
    drone = mujoco.MjSpec.from_file(str(default_scene_path()))
    for key in list(drone.keys):
        drone.delete(key)
    if spec.option.timestep == mujoco.MjSpec().option.timestep:
        spec.option.timestep = drone.option.timestep
    for name in _OPTIONS:  # MuJoCo warns where they differ; the map's own are kept
        setattr(drone.option, name, getattr(spec.option, name))
    numerics = {numeric.name for numeric in spec.numerics}
    spec.worldbody.add_frame().attach_body(drone.body("drone"), _PREFIX, "")
    spec.body(f"{_PREFIX}drone").name = "drone"
    depth_range = next(one for one in spec.numerics if one.name == f"{_PREFIX}depth_range")
    if "depth_range" in numerics:
        spec.delete(depth_range)
    else:
        depth_range.name = "depth_range"
