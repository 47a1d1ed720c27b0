"""The map within an MJCF file: its walls, read and checked."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from pecjax.envs.rooms.maps import FAR_AWAY, MAX_WALLS, MapBank
from pecjax.envs.rooms.mjcf_file import MapFile
from pecjax.envs.rooms.solids import is_along_axes, is_wall
from pecjax.envs.rooms.vehicle_file import geom_kind
from pecjax.errors import InputError

MAX_EXTENT = 1000  # m, from the origin
MOST_COVERED = 0.5  # share of the map, from above, beyond which a box is a floor or a ceiling
_APPROXIMATE = "give --task.approximate 0.05 to have boxes that reach at most 0.05 m beyond it"
ENDLESS = 1e6  # m, where the half-space behind a plane ends


@dataclass(frozen=True)
class Map:
    """What can be hit, and is seen.

    Attributes:
        lower, upper: (W, 3) m, opposite corners of the axis-aligned walls; what lies behind a plane is
            a box that ends `ENDLESS` m away.
        bounds: (2, 2) m, lower and upper corner in x and y of all walls, a plane's endless sides left out.
        names: W names, for messages and figures.
        starts, goals: (S, 2) and (G, 2) m, places that the map marks as such.
    """

    lower: np.ndarray
    upper: np.ndarray
    bounds: np.ndarray
    names: tuple[str, ...]
    starts: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    goals: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def covers(self) -> np.ndarray:
        """(W,) bool, what lies over or under most of the map: floors and ceilings."""
        inside = [np.clip(corner[:, :2], *self.bounds) for corner in (self.lower, self.upper)]
        return np.prod(inside[1] - inside[0], axis=1) > MOST_COVERED * np.prod(np.ptp(self.bounds, axis=0))


def map_of(bank: MapBank, number: int) -> Map:
    """One map of a bank, without the boxes that only fill it up."""
    lower, upper, bounds = (np.asarray(leaf)[number] for leaf in bank)
    real = lower[:, 0] < FAR_AWAY
    names = tuple(f"wall {wall}" for wall in range(int(real.sum())))
    return Map(lower[real], upper[real], bounds, names)


def read_map(map_file: MapFile, drone: int) -> Map:
    """The walls of an MJCF file: all but the drone that can be hit.

    Raises:
        InputError: what can be hit is no box or plane along the axes, moves, or is too much.
    """
    path, model = map_file.path, map_file.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    boxes, names = [], []
    for geom in range(model.ngeom):
        if not is_wall(model, geom, drone):
            continue
        if model.body_weldid[model.geom_bodyid[geom]] != 0:
            raise InputError(f"{map_file.geom(geom)} collides on a mocap body; a wall must not move")
        boxes.append(_box(map_file, geom, data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)))
        names.append(model.geom(geom).name or f"geom {geom}")
    if not names:
        raise InputError(f"{path}: no wall; the map needs at least one box geom that collides")
    if len(names) > MAX_WALLS:
        raise InputError(f"{path}: {len(names)} walls; {MAX_WALLS} is the most, put some together")
    corners = np.array(boxes)
    too_far = (np.abs(corners) > MAX_EXTENT) & ~_is_endless(corners)
    for wall in np.flatnonzero(too_far.any(axis=(1, 2))):
        raise InputError(
            f"{path}: wall '{names[wall]}' reaches beyond {MAX_EXTENT:,} m; make the map smaller"
        )
    lower, upper = corners[:, 0], corners[:, 1]
    return Map(lower, upper, _bounds(path, lower, upper), tuple(names), *_marks(map_file, data, drone))


def _marks(map_file: MapFile, data: mujoco.MjData, drone: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the sites stand whose names begin with start and with goal."""
    model = map_file.model
    sites = [site for site in range(model.nsite) if model.site_bodyid[site] != drone]
    starts, goals = (
        data.site_xpos[[site for site in sites if model.site(site).name.startswith(mark)], :2]
        for mark in ("start", "goal")
    )
    if bool(len(starts)) != bool(len(goals)):
        there, missing = ("starts", "goal") if len(starts) else ("goals", "start")
        raise InputError(f"{map_file.path}: marks {there} and no {missing}; mark both, or neither")
    return starts, goals


def _box(map_file: MapFile, geom: int, position: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Lower and upper corner (2, 3) m of one wall."""
    kind = mujoco.mjtGeom(map_file.model.geom_type[geom])
    if kind not in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_PLANE):
        raise InputError(
            f"{map_file.geom(geom)} collides and is a {geom_kind(kind)}; only boxes and planes can be "
            f'walls: {_APPROXIMATE} (contype="0" conaffinity="0" would let the drone fly through it)'
        )
    right_angled = np.round(axes)
    along = np.abs(axes).max(axis=0)  # cosines of the angles to the nearest axes
    if not is_along_axes(axes):
        off = np.degrees(np.arccos(np.clip(along, 0, 1)))
        raise InputError(
            f"{map_file.geom(geom)} collides and is turned {off.max():.3g}° off the axes; turn it by right "
            f"angles only, or {_APPROXIMATE}"
        )
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        half = np.abs(right_angled) @ map_file.model.geom_size[geom]
        return np.stack([position - half, position + half])
    # MuJoCo's contacts know no edge of a plane: all that lies behind it is solid.
    corners = np.array([[-ENDLESS] * 3, [ENDLESS] * 3])
    axis = int(np.abs(right_angled[:, 2]).argmax())
    corners[int(right_angled[axis, 2] > 0), axis] = position[axis]
    return corners


def _is_endless(corners: np.ndarray) -> np.ndarray:
    return np.abs(corners) == ENDLESS


def _bounds(path: Path, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The corners (2, 2) m in x and y between which all walls end that do end."""
    corners = np.concatenate([lower, upper])[:, :2]
    ends = ~_is_endless(corners)
    if not np.all(ends.any(axis=0)):
        raise InputError(f"{path}: no wall but planes; the map needs at least one box geom that collides")
    low = np.min(corners, axis=0, where=ends, initial=np.inf)
    return np.stack([low, np.max(corners, axis=0, where=ends, initial=-np.inf)])
