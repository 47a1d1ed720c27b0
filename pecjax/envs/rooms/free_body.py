"""Free body: MuJoCo's step of a body that gravity, a force and a torque act on, in closed form.

Vectors are tuples of scalars here. Under `vmap` each scalar is one array that lies in a row, so that a step
becomes a few loops over the batch; the same arithmetic on arrays (B, 3) takes many times as long.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pecjax.envs.rooms.rotations import cross, dot, quaternion_product

Vector = tuple[Any, ...]  # of scalars () that are all of one type
_TINY = 1e-30  # added to a square that is divided by: no turn at all stays one


class Body(NamedTuple):
    """A free joint's state.

    Attributes:
        position: m, in the world.
        attitude: quaternion w-x-y-z, from the body's frame to the world.
        velocity: m/s, in the world.
        rates: rad/s, in the body's frame.
    """

    position: Vector
    attitude: Vector
    velocity: Vector
    rates: Vector


def split(qpos: jax.Array, qvel: jax.Array) -> Body:
    """The body of MuJoCo's qpos (7,) and qvel (6,)."""
    pose, speed = tuple(qpos), tuple(qvel)
    return Body(pose[:3], pose[3:], speed[:3], speed[3:])


def join(body: Body) -> tuple[jax.Array, jax.Array]:
    """MuJoCo's qpos (7,) and qvel (6,) of a body."""
    return jnp.stack([*body.position, *body.attitude]), jnp.stack([*body.velocity, *body.rates])


def step(
    body: Body, force: Vector, torque: Vector, mass: Any, inertia: Vector, gravity: float, timestep: float
) -> Body:
    """The body after one step of MuJoCo's semi-implicit Euler integrator.

        v' = v + Δt (F / m − g e_z),   ω' = ω + Δt I⁻¹ (τ − ω × I ω),   x' = x + Δt v',   q' = q ⊗ exp(Δt ω')

    Oracle: C MuJoCo's `mj_step`.

    Args:
        force: N, in the world, at the centre of mass.
        torque: N m, in the body's frame.
        mass: kg.
        inertia: kg m², about the body's axes.
        gravity: m/s², along -z.
        timestep: s.
    """
    pull = (0.0, 0.0, gravity)
    velocity = tuple(
        v + timestep * (f / mass - g) for v, f, g in zip(body.velocity, force, pull, strict=True)
    )
    spin = tuple(i * w for i, w in zip(inertia, body.rates, strict=True))
    rates = tuple(
        w + timestep * (t - c) / i
        for w, t, c, i in zip(body.rates, torque, cross(body.rates, spin), inertia, strict=True)
    )
    position = tuple(x + timestep * v for x, v in zip(body.position, velocity, strict=True))
    speed = jnp.sqrt(dot(rates, rates) + _TINY)
    half = 0.5 * timestep * speed
    share = jnp.sin(half) / speed
    turned = quaternion_product(body.attitude, (jnp.cos(half), *(share * w for w in rates)))
    size = jax.lax.rsqrt(dot(turned, turned))
    return Body(position, tuple(size * part for part in turned), velocity, rates)
