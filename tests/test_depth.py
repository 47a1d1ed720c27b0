import jax
import mujoco
import numpy as np
import pytest
from conftest import extent
from jax import numpy as jnp

import pecjax

NUM_POSES = 40
TOLERANCE = 1e-3  # m
# In float32 a ray that grazes a wall's edge may pass on the other side of it and read the wall behind.
EDGE_FRACTION = 0.002


def poses(scene, seed):
    """Positions all over the map, half of them at any attitude, half of them nearly level."""
    rng = np.random.default_rng(seed)
    low, high = extent(scene)
    positions = rng.uniform(low + 0.2, high - 0.2, (NUM_POSES, 3))
    anyhow = rng.normal(size=(NUM_POSES // 2, 4))  # normalised, uniform over SO(3)
    heading = rng.uniform(-np.pi, np.pi, NUM_POSES // 2)
    level = np.stack([np.cos(heading / 2), *rng.normal(0, 0.05, (2, len(heading))), np.sin(heading / 2)], 1)
    quaternions = np.concatenate([anyhow, level])
    return positions, quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def seen_by_mujoco(model, position, quaternion, near, far):
    """The planar depth image by `mj_ray`, in double precision, from the model alone."""
    data = mujoco.MjData(model)
    data.qpos[:] = [*position, *quaternion]
    mujoco.mj_forward(model, data)
    origin, axes = data.cam_xpos[0], data.cam_xmat[0].reshape(3, 3)
    width, height = model.cam_resolution[0]
    drone = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "drone")
    only_walls = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    pixel = 2 * np.tan(np.deg2rad(model.cam_fovy[0]) / 2) / height
    image = np.full((height, width), np.inf)
    for row in range(height):
        for column in range(width):
            right, up = (column + 0.5 - width / 2) * pixel, (height / 2 - row - 0.5) * pixel
            ray = axes @ (right, up, -1.0)
            length = np.linalg.norm(ray)
            hit = np.zeros(1, np.int32)
            distance = mujoco.mj_ray(model, data, origin, ray / length, only_walls, 1, drone, hit)
            if hit[0] >= 0:
                image[row, column] = distance / length
    return np.clip(image, near, far)


@pytest.mark.parametrize("which", ["scene", "other_scene", "plane_scene"])
def test_agrees_with_mujoco_rays_at_any_attitude(which, request):
    scene = request.getfixturevalue(which)
    positions, quaternions = poses(scene, seed=1)
    camera = scene.vehicle.camera
    expected = np.array([
        seen_by_mujoco(scene.model, *pose, camera.near, camera.far)
        for pose in zip(positions, quaternions, strict=True)
    ])  # fmt: skip
    cast = jax.jit(jax.vmap(lambda p, q: pecjax.depth_image(scene, p, q)))
    images = cast(jnp.asarray(positions, jnp.float32), jnp.asarray(quaternions, jnp.float32))
    assert images.shape == (NUM_POSES, camera.height, camera.width)
    off = np.abs(images - expected) > TOLERANCE
    assert off.mean() <= EDGE_FRACTION, f"{off.sum()} of {off.size} pixels"
    # The oracle saw near and far walls as well as nothing at all, else agreeing would be easy.
    assert 0.05 < (expected == camera.far).mean() < 0.95
    assert len(np.unique(expected.round(2))) > 100


def test_vmap_equals_the_single_call(scene):
    positions, quaternions = (jnp.asarray(x, jnp.float32) for x in poses(scene, seed=2))
    single = jax.jit(lambda p, q: pecjax.depth_image(scene, p, q))
    batch = jax.jit(jax.vmap(single))(positions, quaternions)
    alone = np.array([single(p, q) for p, q in zip(positions, quaternions, strict=True)])
    # Fused multiply-adds differ between the two programs; only edges may tell them apart.
    assert (np.abs(batch - alone) > 1e-4).mean() <= EDGE_FRACTION


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("place", [(0.0, -2.0, 1.2), (-8.0, 0.9, 1.2), (-6.1, -2.0, 1.2), (8.1, 8.1, 2.5)])
def test_rays_along_and_within_wall_faces_give_numbers(scene, place, turn):
    # Odd images have a middle column and row, whose rays run along the axes exactly: here also
    # within the faces y = 0.9 and x = -6.1 and along the outer box's edges.
    odd = pecjax.load_scene(resolution=(15, 11))
    half = turn * np.pi / 4
    quaternion = np.array([np.cos(half), 0, 0, np.sin(half)]).round(7)
    image = pecjax.depth_image(odd, jnp.array(place), jnp.asarray(quaternion, jnp.float32))
    assert np.all(np.isfinite(image))
    assert np.all((image >= odd.vehicle.camera.near) & (image <= odd.vehicle.camera.far))


def test_straight_ahead_reads_the_distance_to_the_wall(scene):
    odd = pecjax.load_scene(resolution=(15, 11))
    image = pecjax.depth_image(odd, jnp.array([0.0, -2.0, 1.2]), jnp.array([1.0, 0, 0, 0]))
    # Planar depth is the same wherever the east wall's face (x = 7.9) is seen.
    np.testing.assert_allclose(image[5, 6:9], 7.8, atol=1e-5)


def test_a_camera_inside_a_wall_sees_what_mujoco_sees(scene):
    rng = np.random.default_rng(3)
    walls = rng.integers(0, 14, 20)
    inside = rng.uniform(scene.wall_lower[walls], scene.wall_upper[walls])
    _, quaternions = poses(scene, seed=3)
    camera, off = scene.vehicle.camera, []
    single = jax.jit(lambda p, q: pecjax.depth_image(scene, p, q))
    for eye, quaternion in zip(inside, quaternions[:20], strict=True):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, quaternion)
        position = eye - turn.reshape(3, 3) @ camera.position
        expected = seen_by_mujoco(scene.model, position, quaternion, camera.near, camera.far)
        image = single(jnp.asarray(position, jnp.float32), jnp.asarray(quaternion, jnp.float32))
        off.append(np.abs(image - expected) > TOLERANCE)
    assert np.mean(off) <= EDGE_FRACTION
