"""The vehicle: the drone's body, camera and rotors, and its physics on its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

if TYPE_CHECKING:
    from pecjax.envs.rooms.quiet_mjx import mjx

# With contacts and constraints off nothing is left to solve, and the sparse mass matrix keeps
# MJX away from batched LAPACK, which is slower and can hang (docs/performance.md).
DISABLED = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
)
_OF_JOINT = ("dof_damping", "dof_armature", "jnt_stiffness", "qpos_spring", "qpos0")
_OPTIONS = ("timestep", "gravity", "wind", "density", "viscosity")


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
class Vehicle:
    """The drone, whatever map it flies in.

    Attributes:
        passive: what acts on it besides gravity and its rotors (see `passive_physics`).
        mjx: the drone alone for MJX, where MJX steps it; None where `free_body.step` does.
        timestep: s, of the physics.
        gravity: m/s², along -z.
        radius: m, of its collision sphere.
        mass: kg.
        inertia: (3,) kg m², about its own axes.
        camera: the depth camera.
        rotors: thrust and torque of the actuators.
    """

    passive: dict[str, np.ndarray]
    mjx: mjx.Model | None
    timestep: float
    gravity: float
    radius: float
    mass: float
    inertia: np.ndarray
    camera: Camera
    rotors: Rotors


def drone_alone(model: mujoco.MjModel, drone: int) -> mujoco.MjModel:
    """A model of the drone's body without its map, with the options that pecjax runs it with."""
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    body = spec.worldbody.add_body(name="drone", mass=model.body_mass[drone], ipos=[0, 0, 0])
    body.explicitinertial = True
    body.inertia = model.body_inertia[drone]
    body.gravcomp = model.body_gravcomp[drone]
    body.add_freejoint()
    alone = spec.compile()
    set_options(alone)
    alone.opt.disableflags |= model.opt.disableflags | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    for name in _OPTIONS:
        value = getattr(model.opt, name)
        if np.ndim(value):
            getattr(alone.opt, name)[:] = value
        else:
            setattr(alone.opt, name, value)
    for name in _OF_JOINT:
        getattr(alone, name)[:] = getattr(model, name)
    return alone


def passive_physics(model: Any, drone: int) -> dict[str, np.ndarray]:
    """What else of a MuJoCo or MJX model acts on the drone, by MJCF's names: air, damping and the like."""
    numbers = {name: getattr(model.opt, name) for name in _OPTIONS}
    numbers |= {name: getattr(model, name) for name in _OF_JOINT if not name.startswith("qpos")}
    # Where the drone stands in the map matters to a spring only.
    numbers["spring"] = model.qpos_spring * np.any(model.jnt_stiffness)
    numbers["gravcomp"] = model.body_gravcomp[drone]
    numbers["flags"] = int(model.opt.disableflags) | int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    return {name.rpartition("_")[2]: np.asarray(value, np.float32) for name, value in numbers.items()}


def is_free_body(passive: dict[str, np.ndarray]) -> bool:
    """Whether nothing but rotors, and gravity along -z, acts on the drone: then `free_body.step` is exact."""
    others = ("damping", "armature", "stiffness", "density", "viscosity", "gravcomp")
    is_pulled = not int(passive["flags"]) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    return is_pulled and not np.any(passive["gravity"][:2]) and not any(np.any(passive[n]) for n in others)


def set_options(model: mujoco.MjModel) -> None:
    """Sets the options that pecjax runs a model with."""
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.disableflags |= DISABLED
