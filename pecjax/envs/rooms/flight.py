"""Flight: the drone moves under its controller, and how near it comes to the walls."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from pecjax.envs.rooms import free_body
from pecjax.envs.rooms.air import drag_force
from pecjax.envs.rooms.clearance import least_distance, squared_distance
from pecjax.envs.rooms.controller import Command, ControllerGains, steer
from pecjax.envs.rooms.free_body import Body, Vector
from pecjax.envs.rooms.maps import FEW_WALLS, Walls
from pecjax.envs.rooms.rotations import dot, heading_to_quaternion, rotation_rows
from pecjax.envs.rooms.vehicle import Vehicle


class DroneState(NamedTuple):
    """The free joint's state, all that physics carries from step to step.

    Attributes:
        qpos: (7,) position m and attitude quaternion w-x-y-z, in the world.
        qvel: (6,) velocity m/s in the world, body rates rad/s in the drone's frame.
    """

    qpos: jax.Array
    qvel: jax.Array


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
    return jnp.stack(steer(vehicle, gains, free_body.split(*state), command))


def physics_step(
    vehicle: Vehicle, state: DroneState, controls: jax.Array, conditions: Conditions = Conditions()
) -> DroneState:
    """One step of MuJoCo's of `vehicle.timestep` seconds under rotor controls (U,)."""
    body = _move(vehicle, free_body.split(*state), tuple(controls), conditions)
    return DroneState(*free_body.join(body))


def _move(vehicle: Vehicle, body: Body, controls: Vector, conditions: Conditions) -> Body:
    if conditions.motor_strength is not None:
        controls = tuple(conditions.motor_strength * control for control in controls)
    thrust, *torque = (dot(tuple(map(float, row)), controls) for row in vehicle.rotors.wrench)
    # Given as the force that MuJoCo's site actuators come to.
    rows = rotation_rows(body.attitude)
    force = tuple(thrust * row[2] for row in rows)
    if conditions.air is not None:
        drag = drag_force(conditions.drag, tuple(conditions.air), rows, body.velocity)
        force = tuple(one + other for one, other in zip(force, drag, strict=True))
    growth = 1.0 if conditions.payload is None else 1 + conditions.payload / vehicle.mass
    if vehicle.mjx is not None:
        from pecjax.envs.rooms.mjx_step import mjx_step  # which only few drones need

        return mjx_step(vehicle.mjx, body, force, tuple(torque), growth)
    mass, inertia = growth * vehicle.mass, tuple(growth * float(i) for i in vehicle.inertia)
    return free_body.step(body, force, tuple(torque), mass, inertia, vehicle.gravity, vehicle.timestep)


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

    def move(body: Body) -> Body:
        return _move(vehicle, body, steer(vehicle, gains, body, command), conditions)

    first = free_body.split(*state)
    if walls.lower.shape[0] > FEW_WALLS:

        def step_and_place(body: Body, _: None) -> tuple[Body, jax.Array]:
            body = move(body)
            return body, jnp.stack(body.position)

        body, places = jax.lax.scan(step_and_place, first, None, num_steps)
        return DroneState(*free_body.join(body)), least_distance(walls, places)

    def step(_: int, carry: tuple[Body, jax.Array]) -> tuple[Body, jax.Array]:
        body, nearest = carry
        body = move(body)
        return body, jnp.minimum(nearest, squared_distance(walls, body.position))

    nothing_near = jnp.full((), jnp.inf, state.qpos.dtype)
    body, nearest = jax.lax.fori_loop(0, num_steps, step, (first, nothing_near))
    return DroneState(*free_body.join(body)), jnp.sqrt(nearest)
