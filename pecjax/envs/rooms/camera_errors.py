"""Errors of the depth camera: fog, noise and pixels without a reading."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.vehicle import Camera


def with_errors(camera: Camera, config: Configurations, key: jax.Array, depth: jax.Array) -> jax.Array:
    """A depth image (H, W) m as the camera gives it in an episode of this configuration.

    What lies beyond the visibility reads `far`, as do pixels without a reading. Noise is normal, its
    standard deviation proportional to the depth, and leaves alone what reads `far`.
    """
    key_noise, key_dropout = jax.random.split(key)
    if config.visibility is not None:
        depth = jnp.where(depth > config.visibility, camera.far, depth)
    if config.depth_noise is not None:
        noisy = depth * (1 + config.depth_noise * jax.random.normal(key_noise, depth.shape))
        depth = jnp.where(depth < camera.far, jnp.clip(noisy, camera.near, camera.far), depth)
    if config.depth_dropout is not None:
        dropped = jax.random.uniform(key_dropout, depth.shape) < config.depth_dropout
        depth = jnp.where(dropped, camera.far, depth)
    return depth
