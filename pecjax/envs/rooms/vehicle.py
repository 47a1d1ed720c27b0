"""The drone within an MJCF file: its sphere, inertia, camera and rotors, read and checked."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from pecjax.envs.rooms.mjcf_file import MapFile
from pecjax.errors import InputError

DEFAULT_DEPTH_RANGE = (0.1, 10.0)
MAX_PIXELS = 2**20  # of a depth image


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


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom can touch anything."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def check_joints(map_file: MapFile, drone: int) -> None:
    """Makes sure that the drone has one free joint, and that nothing else has any.

    Raises:
        InputError: the first joint that is wrong, or the one that is missing.
    """
    model, path = map_file.model, map_file.path
    for name, body, place in map_file.joints:
        if body != "drone":
            said = f"joint '{name}'" if name else "a joint"
            on = f"the body '{body}'" if body else "a body without a name"
            raise InputError(
                f"{place}: {said} of {on} moves it, and nothing else may move than the drone; take it out"
            )
    joint = int(model.body_jntadr[drone])
    is_free = model.body_jntnum[drone] == 1 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    if not is_free:
        place = map_file.joints[0][2] if map_file.joints else str(path)
        raise InputError(
            f"{place}: the body 'drone' needs one free joint and no other; write <freejoint/> in it"
        )


def read_radius(map_file: MapFile, drone: int) -> float:
    """Radius (m) of the one sphere that the drone collides with."""
    model = map_file.model
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == drone and collides(model, g)]
    needs = "the body 'drone' needs exactly one geom that collides, a sphere at its origin"
    if not geoms:
        raise InputError(f'{map_file.path}: {needs}; it has none, write <geom type="sphere" size=…/> in it')
    if len(geoms) > 1:
        raise InputError(
            f"{map_file.geom(geoms[1])} is one of {len(geoms)} that collide, and {needs}; "
            'give those that are for show contype="0" conaffinity="0"'
        )
    kind = mujoco.mjtGeom(model.geom_type[geoms[0]])
    if kind != mujoco.mjtGeom.mjGEOM_SPHERE or np.any(model.geom_pos[geoms[0]]):
        wrong = "off its origin" if kind == mujoco.mjtGeom.mjGEOM_SPHERE else f"a {geom_kind(kind)}"
        raise InputError(f"{map_file.geom(geoms[0])} is {wrong}, and {needs}; make it one")
    return float(model.geom_size[geoms[0], 0])


def geom_kind(kind: mujoco.mjtGeom) -> str:
    """The word that MJCF has for a kind of geom."""
    return kind.name.removeprefix("mjGEOM_").lower()


def read_inertia(map_file: MapFile, drone: int) -> np.ndarray:
    """Principal moments (3,) kg m² about the drone's own axes."""
    model = map_file.model
    turned = abs(model.body_iquat[drone, 0]) < 1 - 1e-6
    if turned or np.any(np.abs(model.body_ipos[drone]) > 1e-6):
        raise InputError(
            f"{map_file.path}: the drone's centre of mass must be its origin and its principal axes its own; "
            'write <inertial pos="0 0 0" mass=… diaginertia=…>'
        )
    return model.body_inertia[drone].copy()


def read_camera(map_file: MapFile, drone: int) -> Camera:
    """The first camera on the drone."""
    model, path = map_file.model, map_file.path
    cameras = [c for c in range(model.ncam) if model.cam_bodyid[c] == drone]
    if not cameras:
        raise InputError(f"{path}: no camera on the body 'drone'; add <camera fovy=… resolution=…>")
    camera = cameras[0]
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.cam_quat[camera])
    width, height = (int(n) for n in model.cam_resolution[camera])
    if width < 1 or height < 1 or width * height == 1:
        raise InputError(f"{path}: the camera's resolution is {width}×{height}; give it more pixels")
    if width * height > MAX_PIXELS:
        raise InputError(f"{path}: the camera has {width}×{height} pixels; {MAX_PIXELS:,} is the most")
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


def read_rotors(map_file: MapFile, drone: int) -> Rotors:
    """Asks MuJoCo what one unit of each control does to a level drone."""
    model, path = map_file.model, map_file.path
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
