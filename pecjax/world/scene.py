"""Scene: an MJCF file read once, checked, and turned into the arrays the world is made of."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mujoco import mjx

from pecjax.errors import InputError

DEFAULT_DEPTH_RANGE = (0.1, 10.0)

# With contacts and constraints off nothing is left to solve, and the sparse mass matrix keeps
# MJX away from batched LAPACK, which is slower and can hang (docs/performance.md).
_DISABLED = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
)


@dataclass(frozen=True)
class Camera:
    """A pinhole depth camera fixed to the drone.

    Attributes:
        position: (3,) m, in the drone's frame.
        rotation: (3, 3), columns are the camera's right, up and backward axes in that frame.
        fovy: vertical field of view, radians.
        height, width: pixels.
        near, far: range of planar depth, m; what lies beyond `far` reads `far`.
    """

    position: np.ndarray
    rotation: np.ndarray
    fovy: float
    height: int
    width: int
    near: float
    far: float


@dataclass(frozen=True)
class Rotors:
    """What the rotors can do, about the drone's centre of mass and in its own frame.

    Attributes:
        wrench: (4, U), rows thrust along z (N) and torque x, y, z (N m) per unit of control.
        lower, upper: (U,) control limits.
    """

    wrench: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


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
    model = _compile(path)
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
    return Scene(
        model=model,
        physics=mjx.put_model(_without_actuation(model)),
        wall_lower=wall_lower,
        wall_upper=wall_upper,
        wall_names=wall_names,
        drone_radius=_drone_radius(path, model, drone),
        mass=float(model.body_mass[drone]),
        inertia=_inertia(path, model, drone),
        camera=_camera(path, model, drone),
        rotors=_rotors(path, model, drone),
    )


def _compile(path: Path) -> mujoco.MjModel:
    if not path.is_file():
        raise InputError(f"{path}: no such scene file; give the path of an MJCF file")
    try:
        ElementTree.parse(path)
    except (ElementTree.ParseError, ValueError, LookupError, OSError) as error:
        raise InputError(f"{path}: not XML ({error}); give an MJCF file") from error
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: MuJoCo cannot compile it: {reason}") from error


def _without_actuation(model: mujoco.MjModel) -> mujoco.MjModel:
    model = copy.copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    return model


def _collides(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def _walls(path: Path, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lower, upper, names = [], [], []
    for geom in range(model.ngeom):
        if model.body_weldid[model.geom_bodyid[geom]] != 0 or not _collides(model, geom):
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
    return np.array(lower), np.array(upper), tuple(names)


def _drone_radius(path: Path, model: mujoco.MjModel, drone: int) -> float:
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == drone and _collides(model, g)]
    is_sphere = len(geoms) == 1 and model.geom_type[geoms[0]] == mujoco.mjtGeom.mjGEOM_SPHERE
    if not is_sphere or np.any(model.geom_pos[geoms[0]]):
        raise InputError(
            f"{path}: the body 'drone' needs exactly one geom that collides, a sphere at its origin"
        )
    return float(model.geom_size[geoms[0], 0])


def _inertia(path: Path, model: mujoco.MjModel, drone: int) -> np.ndarray:
    turned = abs(model.body_iquat[drone, 0]) < 1 - 1e-6
    if turned or np.any(np.abs(model.body_ipos[drone]) > 1e-6):
        raise InputError(
            f"{path}: the drone's centre of mass must be its origin and its principal axes its own; "
            'write <inertial pos="0 0 0" mass=… diaginertia=…>'
        )
    return model.body_inertia[drone].copy()


def _camera(path: Path, model: mujoco.MjModel, drone: int) -> Camera:
    cameras = [c for c in range(model.ncam) if model.cam_bodyid[c] == drone]
    if not cameras:
        raise InputError(f"{path}: no camera on the body 'drone'; add <camera fovy=… resolution=…>")
    camera = cameras[0]
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.cam_quat[camera])
    width, height = (int(n) for n in model.cam_resolution[camera])
    if width < 1 or height < 1 or width * height == 1:
        raise InputError(f"{path}: the camera's resolution is {width}×{height}; give it more pixels")
    if np.any(model.cam_sensorsize[camera]):
        raise InputError(f"{path}: the camera has intrinsics of its own; describe it by fovy alone")
    depth_range = np.array(DEFAULT_DEPTH_RANGE)
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, "depth_range") >= 0:
        depth_range = model.numeric("depth_range").data
    if depth_range.size != 2 or not 0 <= depth_range[0] < depth_range[1]:
        raise InputError(f"{path}: depth_range is {depth_range}; write two lengths that rise from 0 or more")
    near, far = depth_range.tolist()
    fovy = float(np.deg2rad(model.cam_fovy[camera]))
    return Camera(model.cam_pos[camera].copy(), rotation.reshape(3, 3), fovy, height, width, near, far)


def _rotors(path: Path, model: mujoco.MjModel, drone: int) -> Rotors:
    """Asks MuJoCo what one unit of each control does to a level drone."""
    sites = model.site_bodyid[model.actuator_trnid[:, 0]] if model.nu else np.array([])
    on_drone = np.all(model.actuator_trntype == mujoco.mjtTrn.mjTRN_SITE) and np.all(sites == drone)
    limits = model.actuator_ctrlrange.copy()
    if model.nu < 4 or not on_drone or model.na or not np.all(limits[:, 1] > 0):
        raise InputError(
            f"{path}: the drone needs four or more site actuators without state, each with a ctrlrange "
            "that reaches above 0"
        )
    data = mujoco.MjData(model)
    data.qpos[3:] = (1, 0, 0, 0)
    wrench = np.zeros((6, model.nu))
    for rotor in range(model.nu):
        data.ctrl[:] = 0
        data.ctrl[rotor] = limits[rotor, 1]
        mujoco.mj_forward(model, data)
        wrench[:, rotor] = data.qfrc_actuator / limits[rotor, 1]
    weight = -float(model.opt.gravity[2] * model.body_mass[drone])
    if np.any(np.abs(wrench[:2]) > 1e-9):
        raise InputError(
            f"{path}: the rotors must push along the drone's own z axis; turn their sites upright"
        )
    wrench = wrench[2:]
    if np.linalg.matrix_rank(wrench) < 4 or wrench[0] @ limits[:, 1] <= weight:
        raise InputError(
            f"{path}: the rotors cannot hold the drone; they must steer roll, pitch and yaw and "
            f"lift more than its weight of {weight:.1f} N"
        )
    return Rotors(wrench, limits[:, 0], limits[:, 1])
