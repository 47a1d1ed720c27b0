"""MJX's step, for a drone that more acts on than gravity and its rotors."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from pecjax.envs.rooms import free_body
from pecjax.envs.rooms.free_body import Body, Vector
from pecjax.envs.rooms.quiet_mjx import mjx


def mjx_step(model: mjx.Model, body: Body, force: Vector, torque: Vector, growth: Any) -> Body:
    """`free_body.step` by MJX.

    Args:
        model: of the drone alone (see `vehicle.drone_alone`).
        growth: () by which a payload has made mass and inertia grow.
    """
    loaded = model.replace(
        body_mass=model.body_mass * growth,
        body_subtreemass=model.body_subtreemass * growth,
        body_inertia=model.body_inertia * growth,
    )
    qpos, qvel = free_body.join(body)
    data = mjx.make_data(model).replace(qpos=qpos, qvel=qvel, qfrc_applied=jnp.stack([*force, *torque]))
    with jax.default_matmul_precision("highest"):  # GPUs would round products to 11 bits
        data = mjx.step(loaded, data)
    return free_body.split(data.qpos, data.qvel)
