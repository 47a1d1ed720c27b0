"""Approximation: shapes that are no boxes along the axes, as boxes that hold them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from pecjax.envs.rooms.box_cover import BoxCover, cover
from pecjax.envs.rooms.maps import MAX_WALLS
from pecjax.envs.rooms.solids import corners_of, is_along_axes, is_wall
from pecjax.errors import InputError

MIN_REACH = 0.001  # m
_SLACK = 0.2  # share of the reach that making round shapes many-sided may take
_MOST_NAMES = 3


def approximate_shapes(
    spec: mujoco.MjSpec, model: mujoco.MjModel, reach: float, place_of: Callable[[str, Any], str]
) -> list[str]:
    """Puts boxes along the axes in the place of the shapes of a map that are none, in place.

    The boxes hold all of the shape: what MuJoCo says is solid still is.

    Args:
        model: `spec` compiled.
        reach: m, how far a box may reach beyond its shape.
        place_of: (kind, element) -> where it stands, for messages.

    Returns:
        what has become of which shapes, for people; nothing where there are none.

    Raises:
        InputError: a reach of less than a millimetre, or a shape that takes too many boxes.
    """
    if not MIN_REACH <= reach < np.inf:
        raise InputError(f"approximate is {reach}; give metres, {MIN_REACH:g} at least, 0.05 say")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    drone = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "drone")
    names: list[str] = []
    covers: list[BoxCover] = []
    left = MAX_WALLS
    for geom, number in [(geom, geom.id) for geom in spec.geoms]:  # which change with the first that goes
        if not is_wall(model, number, drone) or model.body_weldid[model.geom_bodyid[number]] != 0:
            continue
        axes = data.geom_xmat[number].reshape(3, 3)
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX and is_along_axes(axes):
            continue
        name = f"'{geom.name}'" if geom.name else f"{number}"
        boxes = _boxes(model, data, number, reach, left, f"{place_of('geom', geom)}: geom {name}")
        if boxes is None:
            continue
        left -= len(boxes.middle)
        names.append(name)
        covers.append(boxes)
        _replace(spec, geom, boxes)
    if not covers:
        return []
    shown = ", ".join(names[:_MOST_NAMES]) + (", …" if len(names) > _MOST_NAMES else "")
    many, furthest = sum(len(boxes.middle) for boxes in covers), max(boxes.reach for boxes in covers)
    return [
        f"{many} boxes along the axes stand for geom {shown}; they hold all of it and reach at most "
        f"{np.ceil(1e4 * furthest) / 1e4:g} m beyond"
    ]


def _boxes(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, reach: float, most: int, name: str
) -> BoxCover | None:
    try:
        found = corners_of(model, geom, _SLACK * reach)
        if found is None:
            return None
        corners, beyond = found
        corners = data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T
        boxes = cover(corners, reach - beyond, most)
    except InputError as error:
        raise InputError(
            f"{name} cannot be approximated to {reach:g} m: {error}; ask for less with a larger "
            "--task.approximate, or build it of boxes"
        ) from None
    return boxes._replace(reach=boxes.reach + beyond)


def _replace(spec: mujoco.MjSpec, geom: Any, boxes: BoxCover) -> None:
    taken = {other.name for other in spec.geoms}
    free = (f"{geom.name or 'shape'}_{number}" for number in itertools.count())
    names = (name for name in free if name not in taken)
    for middle, half in zip(boxes.middle, boxes.half, strict=True):
        box = spec.worldbody.add_geom(name=next(names), type=mujoco.mjtGeom.mjGEOM_BOX, pos=middle, size=half)
        box.quat, box.fromto, box.mass = [1, 0, 0, 0], np.full(6, np.nan), 0
        for name in ("contype", "conaffinity", "condim", "group", "rgba", "material"):
            setattr(box, name, getattr(geom, name))
    spec.delete(geom)
