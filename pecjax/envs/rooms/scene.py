"""Scene: an MJCF file read once, checked, and turned into the arrays the world is made of."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path

import jax
import mujoco
import numpy as np

from pecjax.envs.rooms.mjcf_file import MapFile, read_mjcf
from pecjax.envs.rooms.quiet_mjx import mjx
from pecjax.envs.rooms.vehicle import (
    MAX_PIXELS,
    Camera,
    Rotors,
    check_joints,
    collides,
    geom_kind,
    read_camera,
    read_inertia,
    read_radius,
    read_rotors,
)
from pecjax.errors import InputError

MAX_WALLS = 1000  # each is a part of every step's program
MAX_EXTENT = 1000  # m, from the origin
ENDLESS = 1e6  # m, where the half-space behind a plane ends

# With contacts and constraints off nothing is left to solve, and the sparse mass matrix keeps
# MJX away from batched LAPACK, which is slower and can hang (docs/performance.md).
_DISABLED = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
)


@dataclass(frozen=True)
class Scene:
    """Everything that comes from the MJCF file.

    Attributes:
        model: the compiled MuJoCo model, with the options that pecjax runs it with.
        physics: the same model for MJX, its rotors left to `flight.physics_step`.
        wall_lower, wall_upper: (W, 3) m, opposite corners of the axis-aligned walls; what lies behind
            a plane is a box that ends `ENDLESS` m away.
        bounds: (2, 2) m, lower and upper corner in x and y of all walls, a plane's endless sides left out.
        wall_names: W names, for messages and figures.
        drone_radius: m, of the drone's collision sphere.
        mass: kg.
        inertia: (3,) kg m², about the drone's own axes.
        camera: the depth camera.
        rotors: thrust and torque of the actuators.
    """

    model: mujoco.MjModel
    physics: mjx.Model
    wall_lower: np.ndarray
    wall_upper: np.ndarray
    bounds: np.ndarray
    wall_names: tuple[str, ...]
    drone_radius: float
    mass: float
    inertia: np.ndarray
    camera: Camera
    rotors: Rotors


def default_scene_path() -> Path:
    """The map of six rooms: inside the installed package, or in the checkout beside it."""
    package = Path(__file__).resolve().parents[2]
    shipped = package / "assets" / "rooms.xml"
    return shipped if shipped.exists() else package.parent / "assets" / "rooms.xml"


def load_scene(path: str | Path | None = None, resolution: tuple[int, int] | None = None) -> Scene:
    """Reads a map and its drone from an MJCF file.

    The file must hold one body named `drone` with a free joint, a collision sphere, a camera and
    at least four site actuators; every other geom that can collide must be a box or a plane along the
    axes and is a wall: it is both hit and seen. The numeric `depth_range` (near, far) is optional.
    `docs/maps.md` has the details.

    Args:
        path: the MJCF file; the six rooms of the paper when None.
        resolution: (width, height) in pixels of the depth image, instead of the file's.

    Raises:
        InputError: the file is missing, is not MJCF, or lacks one of the above.
    """
    path = default_scene_path() if path is None else Path(path)
    map_file = read_mjcf(path)
    model = map_file.model
    drone = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "drone")
    if drone < 0:
        raise InputError(f"{path}: no body named 'drone'; give the drone's body that name")
    check_joints(map_file, drone)
    if np.any(model.body_parentid[drone + 1 :] == drone):
        raise InputError(
            f"{path}: the drone must be one body; put its geoms, sites and camera on 'drone' itself"
        )
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.disableflags |= _DISABLED
    if resolution is not None:
        if not all(0 < pixels <= MAX_PIXELS for pixels in resolution):
            raise InputError(f"resolution is {resolution}; give a width and a height in pixels")
        model.cam_resolution[:] = resolution
    wall_lower, wall_upper, wall_names = _walls(map_file, drone)
    radius, inertia = read_radius(map_file, drone), read_inertia(map_file, drone)
    camera, rotors = read_camera(map_file, drone), read_rotors(map_file, drone)
    try:
        # Its own choice is the first device of all, which may be another process's.
        physics = mjx.put_model(_without_actuation(model), device=jax.local_devices()[0])
    except NotImplementedError as error:  # raised by MJX for a MuJoCo feature that it does not support
        raise InputError(f"{path}: MJX cannot simulate it: {error}") from error
    return Scene(
        model=model,
        physics=physics,
        wall_lower=wall_lower,
        wall_upper=wall_upper,
        bounds=_bounds(path, wall_lower, wall_upper),
        wall_names=wall_names,
        drone_radius=radius,
        mass=float(model.body_mass[drone]),
        inertia=inertia,
        camera=camera,
        rotors=rotors,
    )


def _without_actuation(model: mujoco.MjModel) -> mujoco.MjModel:
    model = copy.copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    return model


def _walls(map_file: MapFile, drone: int) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Lower and upper corners (W, 3) m and names of all that can be hit."""
    path, model = map_file.path, map_file.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    boxes, names = [], []
    for geom in range(model.ngeom):
        body = model.geom_bodyid[geom]
        if body == drone or not collides(model, geom):
            continue
        if model.body_weldid[body] != 0:
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
    return corners[:, 0], corners[:, 1], tuple(names)


def _box(map_file: MapFile, geom: int, position: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Lower and upper corner (2, 3) m of one wall."""
    kind = mujoco.mjtGeom(map_file.model.geom_type[geom])
    if kind not in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_PLANE):
        raise InputError(
            f"{map_file.geom(geom)} collides and is a {geom_kind(kind)}; only boxes and planes can be "
            'walls: build it of boxes (contype="0" conaffinity="0" would let the drone fly through it)'
        )
    right_angled = np.round(axes)
    along = np.abs(axes).max(axis=0)  # cosines of the angles to the nearest axes
    if not np.allclose(along, 1.0, atol=1e-6):
        off = np.degrees(np.arccos(np.clip(along, 0, 1)))
        raise InputError(
            f"{map_file.geom(geom)} collides and is turned {off.max():.3g}° off the axes; turn it by right "
            "angles only, or build it of boxes that are not turned"
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
