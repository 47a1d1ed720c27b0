"""Depth: what the drone's pinhole camera sees, by ray casting against the scene's walls."""

from __future__ import annotations

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.rooms.maps import FEW_WALLS, Walls
from pecjax.envs.rooms.rotations import quaternion_to_matrix
from pecjax.envs.rooms.scene import Scene
from pecjax.envs.rooms.vehicle import Camera
from pecjax.envs.rooms.visibility import any_left, could_be_seen, pack, take_first

_WALLS_A_ROUND = 4  # of those in view


def pixel_directions(camera: Camera) -> np.ndarray:
    """Directions (H, W, 3) through the pixel centres, in the drone's frame.

    Each has unit length along the optical axis, so that a ray's parameter is planar depth.
    Row 0 is the top of the image, column 0 its left.
    """
    half_height = np.tan(camera.fovy / 2)
    half_width = half_height * camera.width / camera.height
    x = ((np.arange(camera.width) + 0.5) / camera.width * 2 - 1) * half_width
    y = (1 - (np.arange(camera.height) + 0.5) / camera.height * 2) * half_height
    x, y = np.meshgrid(x, y)
    return np.stack([x, y, -np.ones_like(x)], axis=-1) @ camera.rotation.T


def depth_image(scene: Scene, position: jax.Array, quaternion: jax.Array) -> jax.Array:
    """The depth image of one drone in a scene (see `render_depth`)."""
    return render_depth(scene.vehicle.camera, scene.walls, position, quaternion)


def render_depth(camera: Camera, walls: Walls, position: jax.Array, quaternion: jax.Array) -> jax.Array:
    """The depth image of one drone among walls.

    Args:
        position: (3,) m, the drone's origin.
        quaternion: (4,) its attitude, w-x-y-z, unit length.

    Returns:
        (H, W) m, planar depth (along the optical axis), clipped to the camera's range; a ray that
        meets no wall reads the far end. Oracle: `mujoco.mj_ray`.
    """
    rotation = quaternion_to_matrix(quaternion)
    local = jnp.asarray(pixel_directions(camera).reshape(-1, 3).T, position.dtype)
    with jax.default_matmul_precision("highest"):  # GPUs would round products to 11 bits
        origin = position + rotation @ jnp.asarray(camera.position, position.dtype)
        directions = rotation @ local
    if walls.lower.shape[0] > FEW_WALLS:
        depth = raycast_in_view(camera, walls, rotation, origin, directions)
    else:
        depth = raycast(walls, origin, directions)
    return jnp.clip(depth, camera.near, camera.far).reshape(camera.height, camera.width)


def raycast(walls: Walls, origin: jax.Array, directions: jax.Array) -> jax.Array:
    """Parameter (R,) at which rays meet the nearest wall, inf for none (the slab test).

    A ray that starts inside a wall meets it where it leaves.

    Args:
        origin: (3,) m, shared by all rays.
        directions: (3, R), of any length.
    """
    inverse, lower, upper = _from(walls, origin, directions)

    def nearer(best: jax.Array, wall: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        return _nearer(best, wall[0], wall[1], inverse), None

    nothing = jnp.full(directions.shape[1:], jnp.inf, origin.dtype)
    return jax.lax.scan(nearer, nothing, (lower, upper), unroll=FEW_WALLS)[0]


def raycast_in_view(
    camera: Camera, walls: Walls, rotation: jax.Array, origin: jax.Array, directions: jax.Array
) -> jax.Array:
    """`raycast` of the camera's rays, but against the walls that could be in its view, so it ends sooner.

    Further away than the camera's range it may miss a wall. Under `vmap` the loop has as many rounds as the
    drone of the batch with the most walls in view needs, and no reverse-mode gradient.

    Args:
        rotation: (3, 3) from the drone's frame to the world.
        origin, directions: (3,) m and (3, R), of the camera's pixels.
    """
    inverse, lower, upper = _from(walls, origin, directions)

    def some_nearer(carry: tuple[list[jax.Array], jax.Array]) -> tuple[list[jax.Array], jax.Array]:
        left, best = carry
        numbers, number = [], jnp.zeros((), jnp.int32)
        for _ in range(_WALLS_A_ROUND):
            left, number = take_first(left, number)  # a wall again where none is left: it changes nothing
            numbers.append(number)
        some = jnp.stack(numbers)
        for below, above in zip(lower[some], upper[some], strict=True):
            best = _nearer(best, below, above, inverse)
        return left, best

    seen = pack(could_be_seen(camera, rotation, lower, upper))
    nothing = jnp.full(directions.shape[1:], jnp.inf, origin.dtype)
    return jax.lax.while_loop(lambda carry: any_left(carry[0]), some_nearer, (seen, nothing))[1]


def _from(walls: Walls, origin: jax.Array, directions: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Directions inverted, and the walls' corners (W, 3) m as seen from the origin."""
    # An exact zero would turn 0 · inf into NaN for a ray that runs in a wall's face.
    inverse = 1 / jnp.where(jnp.abs(directions) < 1e-9, 1e-9, directions)
    lower = jnp.asarray(walls.lower, origin.dtype) - origin
    return inverse, lower, jnp.asarray(walls.upper, origin.dtype) - origin


def _nearer(best: jax.Array, lower: jax.Array, upper: jax.Array, inverse: jax.Array) -> jax.Array:
    """The rays' parameters (R,), with one more wall."""
    faces = [(lower[axis] * inverse[axis], upper[axis] * inverse[axis]) for axis in range(3)]
    # Written out, not as reductions over the axes: so the loop over rays stays one kernel.
    entry = reduce(jnp.maximum, [jnp.minimum(*pair) for pair in faces])
    leave = reduce(jnp.minimum, [jnp.maximum(*pair) for pair in faces])
    hit = jnp.where(entry > 0, entry, leave)
    return jnp.where((leave >= entry) & (leave > 0), jnp.minimum(best, hit), best)
