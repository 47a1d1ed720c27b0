"""Export: one plan as an MJCF file with the drone of another."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from pecjax.envs.rooms.mjcf_file import read_map_file
from pecjax.envs.rooms.plans.layout import HEIGHT
from pecjax.envs.rooms.plans.plans import FLIGHT_HEIGHT, Plans
from pecjax.envs.rooms.scene import default_scene_path
from pecjax.envs.rooms.vehicle_file import find_drone
from pecjax.errors import InputError

# Red, green, blue, opacity; the ceiling lets the eye in.
_COLOURS = {
    "floor": "0.55 0.5 0.45 1",
    "ceiling": "0.9 0.9 0.9 0.12",
    "wall": "0.75 0.73 0.7 1",
    "pillar": "0.6 0.6 0.65 1",
    "furniture": "0.6 0.42 0.28 1",
    "hanging": "0.85 0.7 0.3 1",
}


def kinds_of_boxes(lower: np.ndarray, upper: np.ndarray) -> list[str]:
    """What each box (w, 3) m of a plan is: floor, ceiling, wall, pillar, furniture or hanging."""
    height, thick = HEIGHT / 100, 0.2 + 1e-4
    kinds = []
    for low, high in zip(np.asarray(lower, np.float64), np.asarray(upper, np.float64), strict=True):
        size = high - low
        full = low[2] <= 0 and high[2] >= height - 1e-4
        if high[2] <= 0:
            kinds.append("floor")
        elif low[2] >= height - 1e-4:
            kinds.append("ceiling")
        elif full and size[:2].min() <= thick and size[:2].max() > thick:
            kinds.append("wall")
        else:
            kinds.append("pillar" if full else "hanging" if low[2] > 0 else "furniture")
    return kinds


def plan_mjcf(plans: Plans, number: int, scene: Path | None = None) -> str:
    """One plan as MJCF: `load_scene` reads the same walls, and MuJoCo's viewer shows it.

    Args:
        number: of the plan, from 0 on.
        scene: the MJCF file whose drone, camera and options it gets; the paper's six rooms when None.

    Raises:
        InputError: there is no such plan, or the scene cannot be read.
    """
    if not 0 <= number < plans.size:
        raise InputError(f"there is no plan {number}; the plans are 0 to {plans.size - 1}")
    base = read_map_file(default_scene_path() if scene is None else scene)
    find_drone(base)
    spec = mujoco.MjSpec.from_string(base.text)
    for geom in list(spec.geoms):
        if geom.parent.name != "drone":
            spec.delete(geom)
    for site in list(spec.sites):
        if site.parent.name != "drone":  # starts and goals that the other map marks
            spec.delete(site)
    spec.modelname = f"plan {number}"
    spec.comment = (
        f"A floor plan of pecjax, of the family {plans.names[plans.family[number]]}. Lengths in metres."
    )
    lower, upper = (np.asarray(corner, np.float64) for corner in plans.boxes(number))
    counts: dict[str, int] = {}
    for low, high, kind in zip(lower, upper, kinds_of_boxes(lower, upper), strict=True):
        counts[kind] = counts.get(kind, -1) + 1
        spec.worldbody.add_geom(
            name=kind if kind in ("floor", "ceiling") else f"{kind}_{counts[kind]}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            # Corners are whole centimetres: in the text's six digits nothing is lost.
            pos=np.round((low + high) / 2, 3),
            size=np.round((high - low) / 2, 3),
            contype=0,
            conaffinity=1,
            condim=1,
            group=0,
            rgba=[float(part) for part in _COLOURS[kind].split()],
        )
    start, goal = plans.start[number], plans.goal[number]
    heading = float(np.arctan2(goal[1] - start[1], goal[0] - start[0]))
    place = [*np.round(start.astype(float), 2), FLIGHT_HEIGHT]
    turned = np.round([np.cos(heading / 2), 0, 0, np.sin(heading / 2)], 6)
    spec.body("drone").pos, spec.body("drone").quat = place, turned
    for key in spec.keys:
        key.qpos = [*place, *turned]
    spec.compile()
    return spec.to_xml()
