"""Approximation: shapes that are no boxes along the axes, as boxes that hold them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from pecjax.envs.rooms.box_cover import BoxCover, cover
from pecjax.envs.rooms.solids import corners_of
from pecjax.errors import InputError

MAX_BOXES = 1000  # of all shapes of a map
_SLACK = 0.2  # share of the reach that making round shapes many-sided may take
_MOST_NAMES = 3


def is_along_axes(axes: np.ndarray) -> bool:
    """Whether axes, the columns (3, 3), are the map's but for right angles."""
    return np.allclose(np.abs(axes).max(axis=0), 1.0, atol=1e-6)


def approximate_shapes(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    solid: Callable[[int], bool],
    reach: float,
    name_of: Callable[[Any], str],
) -> str | None:
    """Puts boxes along the axes in the place of the shapes of a map that are none, in place.

    The boxes hold all of the shape: what MuJoCo says is solid still is.

    Args:
        model: `spec` compiled.
        solid: whether the geom of that number is a wall.
        reach: m, how far a box may reach beyond its shape.
        name_of: what messages call a geom.

    Returns:
        what has become of which shapes, for people; None where there are none.

    Raises:
        InputError: a reach that is not above 0, or a shape that takes too many boxes.
    """
    if not 0 < reach < np.inf:
        raise InputError(f"approximate is {reach}; give a length in metres above 0, 0.05 say")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    names, covers = [], []
    left = MAX_BOXES
    for geom in [geom for geom in spec.geoms if solid(geom.id)]:
        axes = data.geom_xmat[geom.id].reshape(3, 3)
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX and is_along_axes(axes):
            continue
        boxes = _boxes(model, data, geom.id, reach, left, name_of(geom))
        if boxes is None:
            continue
        left -= len(boxes.middle)
        names.append(f"'{geom.name}'" if geom.name else f"geom {geom.id}")
        covers.append(boxes)
        _replace(spec, geom, boxes)
    if not covers:
        return None
    shown = ", ".join(names[:_MOST_NAMES]) + (", …" if len(names) > _MOST_NAMES else "")
    many, furthest = sum(len(boxes.middle) for boxes in covers), max(boxes.reach for boxes in covers)
    return (
        f"{shown}: {many} boxes stand for what is no box along the axes, and reach at most {furthest:.3g} m "
        "beyond it"
    )


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
