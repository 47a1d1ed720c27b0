"""Controller: a velocity command becomes rotor controls.

It is the geometric one of Lee et al. (2010) in the roles of hector_quadrotor's cascade (Meyer et al. 2012):
velocity to acceleration, acceleration to attitude, attitude to torque, torque to rotors. Vectors are tuples
of scalars, as in `free_body`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.rooms.free_body import Body, Vector
from pecjax.envs.rooms.rotations import cross, dot, rotation_rows
from pecjax.envs.rooms.vehicle import Vehicle


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


def steer(vehicle: Vehicle, gains: ControllerGains, body: Body, command: Command) -> Vector:
    """Controls of the rotors that steer the body towards the command, within their limits."""
    rows = rotation_rows(body.attitude)
    forward, left, up = zip(*rows, strict=True)
    level_x, level_y, climb = _acceleration(gains, vehicle.gravity, forward, body, command)
    force = tuple(vehicle.mass * part for part in (level_x, level_y, climb + vehicle.gravity))
    size = jnp.sqrt(dot(force, force))
    tilt_x, tilt_y = dot(force, forward) / size, dot(force, left) / size  # of the wanted thrust

    lag = tuple(command.yaw_rate * part - rate for part, rate in zip(rows[2], body.rates, strict=True))
    angular_acceleration = (
        -gains.attitude * tilt_y + gains.body_rate * lag[0],
        gains.attitude * tilt_x + gains.body_rate * lag[1],
        gains.yaw_rate * lag[2],
    )
    inertia = tuple(map(float, vehicle.inertia))
    spin = tuple(i * w for i, w in zip(inertia, body.rates, strict=True))
    torque = tuple(
        i * a + c for i, a, c in zip(inertia, angular_acceleration, cross(body.rates, spin), strict=True)
    )
    return allocate_rotors(vehicle, dot(force, up), torque)


def _acceleration(
    gains: ControllerGains, gravity: float, nose: Vector, body: Body, command: Command
) -> Vector:
    """The acceleration in m/s² in the world that brings the velocity to the command's."""
    size = jnp.sqrt(dot(nose[:2], nose[:2]))
    ahead = (nose[0] / size, nose[1] / size)
    left = (-ahead[1], ahead[0])
    forward_speed, side_speed = dot(body.velocity[:2], ahead), dot(body.velocity[:2], left)
    turning = command.yaw_rate if gains.turn_feed_forward else 0.0
    forward = gains.velocity * (command.speed - forward_speed) - turning * side_speed
    sideward = -gains.velocity * side_speed + turning * forward_speed
    level = tuple(forward * a + sideward * b for a, b in zip(ahead, left, strict=True))
    limit = float(gravity * np.tan(gains.max_tilt))
    kept = jnp.minimum(1.0, limit / (jnp.sqrt(dot(level, level)) + 1e-6))
    climb = gains.climb * (gains.height * (command.height - body.position[2]) - body.velocity[2])
    return (kept * level[0], kept * level[1], climb)


def allocate_rotors(vehicle: Vehicle, thrust: Any, torque: Vector) -> Vector:
    """Controls of the rotors for a thrust (N) and a torque (N m); yaw yields first at the limits."""
    rotors = vehicle.rotors
    lifts, yaws, shares = [], [], []
    for weights, lower, upper in zip(np.linalg.pinv(rotors.wrench), rotors.lower, rotors.upper, strict=True):
        of_thrust, of_x, of_y, of_z = map(float, weights)
        lift = jnp.clip(of_thrust * thrust + of_x * torque[0] + of_y * torque[1], float(lower), float(upper))
        yaw = of_z * torque[2]
        room = jnp.where(yaw > 0, float(upper) - lift, lift - float(lower))
        lifts.append(lift)
        yaws.append(yaw)
        shares.append(room / jnp.maximum(jnp.abs(yaw), 1e-6))
    share = jnp.minimum(reduce(jnp.minimum, shares), 1.0)
    return tuple(lift + share * yaw for lift, yaw in zip(lifts, yaws, strict=True))
