"""Scene: an MJCF file read once, checked, and turned into the arrays the world is made of."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path

import jax
import mujoco
import numpy as np

from pecjax.errors import InputError
from pecjax.world.drone import (
    Camera,
    Rotors,
    collides,
    read_camera,
    read_inertia,
    read_radius,
    read_rotors,
)
from pecjax.world.mjcf_file import compile_mjcf
from pecjax.world.quiet_mjx import mjx

MAX_WALLS = 1000  # each is a part of every step's program
MAX_EXTENT = 1000  # m, from the origin

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
        wall_lower, wall_upper: (W, 3) m, opposite corners of the axis-aligned walls.
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
    wall_names: tuple[str, ...]
    drone_radius: float
    mass: float
    inertia: np.ndarray
    camera: Camera
    rotors: Rotors


def default_scene_path() -> Path:
    """The map of six rooms: inside the installed package, or in the checkout beside it."""
    package = Path(__file__).resolve().parents[1]
    shipped = package / "assets" / "rooms.xml"
    return shipped if shipped.exists() else package.parent / "assets" / "rooms.xml"


def load_scene(path: str | Path | None = None, resolution: tuple[int, int] | None = None) -> Scene:
    """Reads a map and its drone from an MJCF file.

    The file must hold one body named `drone` with a free joint, a collision sphere, a camera and
    at least four site actuators; every other geom that can collide must be a box along the axes
    and is a wall: it is both hit and seen. The numeric `depth_range` (near, far) is optional.

    Args:
        path: the MJCF file; the six rooms of the paper when None.
        resolution: (width, height) in pixels of the depth image, instead of the file's.

    Raises:
        InputError: the file is missing, is not MJCF, or lacks one of the above.
    """
    path = default_scene_path() if path is None else Path(path)
    model = compile_mjcf(path)
    drone = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "drone")
    if drone < 0:
        raise InputError(f"{path}: no body named 'drone'; name the drone's body so")
    if model.nq != 7 or model.body_jntnum[drone] != 1:
        raise InputError(
            f"{path}: the drone needs a free joint, and nothing else may move "
            f"(found {model.njnt} joints, {model.nq} coordinates)"
        )
    if np.any(model.body_parentid[drone + 1 :] == drone):
        raise InputError(
            f"{path}: the drone must be one body; put its geoms, sites and camera on 'drone' itself"
        )
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.disableflags |= _DISABLED
    if resolution is not None:
        model.cam_resolution[:] = resolution
    wall_lower, wall_upper, wall_names = _walls(path, model)
    try:
        # Its own choice is the first device of all, which may be another process's.
        physics = mjx.put_model(_without_actuation(model), device=jax.local_devices()[0])
    except NotImplementedError as error:  # MJX's word for features of MuJoCo that it lacks
        raise InputError(f"{path}: MJX cannot simulate it: {error}") from error
    return Scene(
        model=model,
        physics=physics,
        wall_lower=wall_lower,
        wall_upper=wall_upper,
        wall_names=wall_names,
        drone_radius=read_radius(path, model, drone),
        mass=float(model.body_mass[drone]),
        inertia=read_inertia(path, model, drone),
        camera=read_camera(path, model, drone),
        rotors=read_rotors(path, model, drone),
    )


def _without_actuation(model: mujoco.MjModel) -> mujoco.MjModel:
    model = copy.copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    return model


def _walls(path: Path, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lower, upper, names = [], [], []
    for geom in range(model.ngeom):
        if model.body_weldid[model.geom_bodyid[geom]] != 0 or not collides(model, geom):
            continue
        name = model.geom(geom).name or f"geom {geom}"
        axes = np.abs(data.geom_xmat[geom].reshape(3, 3))
        is_box = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
        if not is_box or not np.allclose(axes.max(axis=1), 1.0, atol=1e-6):
            raise InputError(
                f"{path}: wall '{name}' is not an axis-aligned box; make it one, or give it "
                'contype="0" conaffinity="0" if it is there for show'
            )
        half = np.round(axes) @ model.geom_size[geom]
        lower.append(data.geom_xpos[geom] - half)
        upper.append(data.geom_xpos[geom] + half)
        names.append(name)
    if not names:
        raise InputError(f"{path}: no wall; the map needs at least one box geom that collides")
    if len(names) > MAX_WALLS:
        raise InputError(f"{path}: {len(names)} walls; {MAX_WALLS} is the most, put some together")
    if not np.all(np.abs([lower, upper]) <= MAX_EXTENT):
        raise InputError(f"{path}: a wall reaches beyond {MAX_EXTENT:,} m; make the map smaller")
    return np.array(lower), np.array(upper), tuple(names)
