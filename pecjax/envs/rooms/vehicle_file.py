"""The vehicle within an MJCF file, read and checked."""

from __future__ import annotations

from typing import Any

import jax
import mujoco
import numpy as np

from pecjax.envs.rooms.mjcf_file import MapFile
from pecjax.envs.rooms.solids import collides
from pecjax.envs.rooms.vehicle import Camera, Rotors, Vehicle, drone_alone, is_free_body, passive_physics
from pecjax.errors import InputError

DEFAULT_DEPTH_RANGE = (0.1, 10.0)
MAX_PIXELS = 2**20  # of a depth image


def find_drone(map_file: MapFile) -> int:
    """The number of the drone's body.

    Raises:
        InputError: there is none, or it is not one free body, or hangs on something.
    """
    model, path = map_file.model, map_file.path
    drone = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "drone")
    if drone < 0:
        raise InputError(
            f"{path}: no body named 'drone', and something moves; give the drone's body that name, or leave "
            "walls alone, which get a drone"
        )
    check_joints(map_file, drone)
    if np.any(model.body_parentid[drone + 1 :] == drone):
        raise InputError(
            f"{path}: the drone must be one body; put its geoms, sites and camera on 'drone' itself"
        )
    for name in ("stiffness", "damping", "armature"):
        if np.any(getattr(model, f"tendon_{name}")):
            raise InputError(f"{path}: a tendon has {name}, and nothing may hold the drone; take that out")
    return drone


def read_vehicle(map_file: MapFile, drone: int, like: Vehicle | None = None, by_mjx: bool = False) -> Vehicle:
    """The drone of an MJCF file.

    Args:
        like: a vehicle that it must be equal to; its physics are used again.
        by_mjx: whether MJX steps it even where its steps have a closed form.

    Raises:
        InputError: it lacks something, or is another one than `like`.
    """
    model = map_file.model
    passive = passive_physics(model, drone)
    parts = {
        "timestep": float(model.opt.timestep),
        "gravity": -float(model.opt.gravity[2]),
        "radius": read_radius(map_file, drone),
        "mass": float(model.body_mass[drone]),
        "inertia": read_inertia(map_file, drone),
        "camera": read_camera(map_file, drone),
        "rotors": read_rotors(map_file, drone),
    }
    if like is not None:
        first = {name: getattr(like, name) for name in parts} | like.passive
        for name, part in (parts | passive).items():
            if not _equal(part, first[name]):
                raise InputError(
                    f"{map_file.path}: its drone differs in {name} from that of the first map; all maps of a "
                    "task need the same drone, in the same air"
                )
        return like
    if is_free_body(passive) and not by_mjx:
        return Vehicle(passive, None, **parts)
    from pecjax.envs.rooms.quiet_mjx import mjx  # takes seconds to import, and most drones do without

    try:
        # Its own choice is the first device of all, which may be another process's.
        physics = mjx.put_model(drone_alone(model, drone), device=jax.local_devices()[0])
    except NotImplementedError as error:  # MJX's own word for a feature that only MuJoCo has
        raise InputError(f"{map_file.path}: MJX cannot simulate it: {error}") from error
    return Vehicle(passive, physics, **parts)


def _equal(one: Any, other: Any) -> bool:
    """Whether two numbers, arrays or dataclasses of them are equal."""
    if hasattr(one, "__dict__"):
        return all(_equal(value, vars(other)[name]) for name, value in vars(one).items())
    return np.array_equal(one, other)


def check_joints(map_file: MapFile, drone: int) -> None:
    """Makes sure that the drone has one free joint, and that nothing else has any.

    Raises:
        InputError: the first joint that is wrong, or the one that is missing.
    """
    model, path = map_file.model, map_file.path
    for name, body, place in map_file.joints:
        if body != "drone":
            what = f"joint '{name}'" if name else "a joint"
            on = f"the body '{body}'" if body else "a body without a name"
            raise InputError(
                f"{place}: {what} of {on} moves it, and nothing else may move than the drone; take it out"
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
    data.qpos[:] = (0, 0, 0, 1, 0, 0, 0)  # wherever it stands: maps with the same drone get the same bits
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
