"""Flight: a velocity command becomes rotor thrusts, and MJX moves the drone.

The controller is the geometric one of Lee et al. (2010) in the roles of hector_quadrotor's
cascade (Meyer et al. 2012): velocity to acceleration, acceleration to attitude, attitude to
torque, torque to rotors; it runs once per physics step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.rooms.air import drag_force
from pecjax.envs.rooms.clearance import least_distance, wall_distance
from pecjax.envs.rooms.maps import FEW_WALLS, Walls
from pecjax.envs.rooms.quiet_mjx import mjx
from pecjax.envs.rooms.rotations import dot, heading_to_quaternion, quaternion_to_matrix
from pecjax.envs.rooms.vehicle import Vehicle


class DroneState(NamedTuple):
    """The free joint's state, all that physics carries from step to step.

    Attributes:
        qpos: (7,) position m and attitude quaternion w-x-y-z, in the world.
        qvel: (6,) velocity m/s in the world, body rates rad/s in the drone's frame.
    """

    qpos: jax.Array
    qvel: jax.Array


class Command(NamedTuple):
    """What the controller is asked to hold.

    Attributes:
        speed: m/s along the heading, level; the speed across it is held at 0.
        yaw_rate: rad/s about the vertical.
        height: m above the origin.
    """

    speed: jax.Array
    yaw_rate: jax.Array
    height: jax.Array | float


class Conditions(NamedTuple):
    """What the controller does not know of; what is None costs nothing.

    Attributes:
        air: (3,) m/s, the air's velocity in the world.
        drag: of the airframe, see `air.drag_force`.
        payload: () kg at the drone's centre of mass.
        motor_strength: () what the rotors give of what they are asked for.
    """

    air: jax.Array | None = None
    drag: tuple[float, float, float] = (0.0, 0.0, 0.0)
    payload: jax.Array | None = None
    motor_strength: jax.Array | None = None


@dataclass(frozen=True)
class ControllerGains:
    """Gains of the velocity controller, torques per unit of inertia.

    Attributes:
        height: 1/s, height error to climb rate.
        climb: 1/s, climb-rate error to acceleration.
        velocity: 1/s, level velocity error to acceleration.
        attitude: 1/s², tilt error to angular acceleration.
        body_rate: 1/s, roll and pitch rate error to angular acceleration.
        yaw_rate: 1/s, yaw-rate error to angular acceleration.
        max_tilt: rad, of the thrust that is asked for.
        turn_feed_forward: adds the acceleration that turning the velocity with the heading takes.
            Without it the drone slips 30-40° off its heading in a fast turn, as the paper's
            simulator did (hector_quadrotor has no such term).
    """

    height: float = 1.5
    climb: float = 5.0
    velocity: float = 3.0
    attitude: float = 130.0
    body_rate: float = 28.0
    yaw_rate: float = 8.0
    max_tilt: float = np.pi / 4
    turn_feed_forward: bool = True


def hover(position: jax.Array, heading: jax.Array) -> DroneState:
    """A drone at rest and level at `position` (3,) m, looking along `heading` rad."""
    return DroneState(
        qpos=jnp.concatenate([position, heading_to_quaternion(heading)]),
        qvel=jnp.zeros(6, position.dtype),
    )


def rotor_controls(
    vehicle: Vehicle, gains: ControllerGains, state: DroneState, command: Command
) -> jax.Array:
    """Rotor controls (U,) that steer the drone towards the command, within their limits."""
    rotation = quaternion_to_matrix(state.qpos[3:])
    velocity, rates = state.qvel[:3], state.qvel[3:]
    acceleration = _acceleration(gains, vehicle.gravity, rotation, state.qpos[2], velocity, command)
    force = vehicle.mass * (acceleration + jnp.array([0, 0, vehicle.gravity], velocity.dtype))
    wanted_up = force / jnp.sqrt(dot(force, force))
    tilt_x, tilt_y = dot(wanted_up, rotation[:, 0]), dot(wanted_up, rotation[:, 1])  # in the drone's frame

    wanted_rates = command.yaw_rate * rotation[2]
    lag = wanted_rates - rates
    angular_acceleration = jnp.stack([
        -gains.attitude * tilt_y + gains.body_rate * lag[0],
        gains.attitude * tilt_x + gains.body_rate * lag[1],
        gains.yaw_rate * lag[2],
    ])  # fmt: skip
    inertia = jnp.asarray(vehicle.inertia, rates.dtype)
    torque = inertia * angular_acceleration + jnp.cross(rates, inertia * rates)
    return allocate_rotors(vehicle, dot(force, rotation[:, 2]), torque)


def _acceleration(
    gains: ControllerGains,
    gravity: float,
    rotation: jax.Array,
    height: jax.Array,
    velocity: jax.Array,
    command: Command,
) -> jax.Array:
    """The acceleration (3,) m/s² in the world that brings the velocity to the command's."""
    nose = rotation[:2, 0]
    ahead = nose / jnp.sqrt(dot(nose, nose))
    left = jnp.stack([-ahead[1], ahead[0]])
    forward_speed, side_speed = dot(velocity[:2], ahead), dot(velocity[:2], left)
    turning = command.yaw_rate if gains.turn_feed_forward else 0.0
    forward = gains.velocity * (command.speed - forward_speed) - turning * side_speed
    sideward = -gains.velocity * side_speed + turning * forward_speed
    level = forward * ahead + sideward * left
    limit = gravity * np.tan(gains.max_tilt)
    level = level * jnp.minimum(1.0, limit / (jnp.sqrt(dot(level, level)) + 1e-6))
    climb = gains.climb * (gains.height * (command.height - height) - velocity[2])
    return jnp.concatenate([level, climb[None]])


def allocate_rotors(vehicle: Vehicle, thrust: jax.Array, torque: jax.Array) -> jax.Array:
    """Rotor controls (U,) for a thrust (N) and a torque (3,) N m; yaw yields first at the limits."""
    inverse = jnp.asarray(np.linalg.pinv(vehicle.rotors.wrench), torque.dtype)
    lower = jnp.asarray(vehicle.rotors.lower, torque.dtype)
    upper = jnp.asarray(vehicle.rotors.upper, torque.dtype)
    lift = inverse[:, 0] * thrust + inverse[:, 1] * torque[0] + inverse[:, 2] * torque[1]
    lift = jnp.clip(lift, lower, upper)
    yaw = inverse[:, 3] * torque[2]
    room = jnp.where(yaw > 0, upper - lift, lift - lower)
    share = jnp.min(room / jnp.maximum(jnp.abs(yaw), 1e-6))
    return lift + jnp.minimum(share, 1.0) * yaw


def physics_step(
    vehicle: Vehicle, state: DroneState, controls: jax.Array, conditions: Conditions = Conditions()
) -> DroneState:
    """One MJX step of `vehicle.timestep` seconds under rotor controls (U,)."""
    if conditions.motor_strength is not None:
        controls = controls * conditions.motor_strength
    wrench = jnp.asarray(vehicle.rotors.wrench, controls.dtype)
    thrust, *torque = (dot(row, controls) for row in wrench)
    # Given as the force that MuJoCo's site actuators come to: MJX's own way there is much longer.
    rotation = quaternion_to_matrix(state.qpos[3:])
    force = thrust * rotation[:, 2]
    if conditions.air is not None:
        force = force + drag_force(conditions.drag, conditions.air, rotation, state.qvel[:3])
    applied = jnp.concatenate([force, jnp.stack(torque)])
    physics = vehicle.physics if conditions.payload is None else _loaded(vehicle, conditions.payload)
    data = mjx.make_data(vehicle.physics).replace(qpos=state.qpos, qvel=state.qvel, qfrc_applied=applied)
    with jax.default_matmul_precision("highest"):  # GPUs would round products to 11 bits
        data = mjx.step(physics, data)
    return DroneState(data.qpos, data.qvel)


def _loaded(vehicle: Vehicle, payload: jax.Array) -> mjx.Model:
    """The physics of a drone that has grown by the payload (kg), its inertia with its mass."""
    physics, growth = vehicle.physics, 1 + payload / vehicle.mass
    return physics.replace(
        body_mass=physics.body_mass * growth,
        body_subtreemass=physics.body_subtreemass * growth,
        body_inertia=physics.body_inertia * growth,
    )


def fly(
    vehicle: Vehicle,
    walls: Walls,
    gains: ControllerGains,
    state: DroneState,
    command: Command,
    num_steps: int,
    conditions: Conditions = Conditions(),
) -> tuple[DroneState, jax.Array]:
    """Holds a command for `num_steps` physics steps.

    Returns:
        the state after them, and () m, the least distance of the drone's origin from a wall at
        the end of any of them.
    """

    def move(state: DroneState) -> DroneState:
        return physics_step(vehicle, state, rotor_controls(vehicle, gains, state, command), conditions)

    if walls.lower.shape[0] > FEW_WALLS:

        def step_and_place(state: DroneState, _: None) -> tuple[DroneState, jax.Array]:
            state = move(state)
            return state, state.qpos[:3]

        state, places = jax.lax.scan(step_and_place, state, None, num_steps)
        return state, least_distance(walls, places)

    def step(_: int, carry: tuple[DroneState, jax.Array]) -> tuple[DroneState, jax.Array]:
        state, nearest = carry
        state = move(state)
        return state, jnp.minimum(nearest, wall_distance(walls, state.qpos[:3]))

    nothing_near = jnp.full((), jnp.inf, state.qpos.dtype)
    return jax.lax.fori_loop(0, num_steps, step, (state, nothing_near))
