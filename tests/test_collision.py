import copy

import jax
import mujoco
import numpy as np
import pytest
from conftest import extent
from jax import numpy as jnp

from pecjax.envs.rooms.clearance import wall_distance

NUM_POINTS = 6000
TOUCHING = 1e-4  # m, where float32 and float64 may differ about who touches


def points_about(scene, seed):
    """Half of them anywhere in and around the map, half near a wall's faces, edges and corners."""
    rng = np.random.default_rng(seed)
    low, high = extent(scene)
    anywhere = rng.uniform(low - 0.5, high + 0.5, (NUM_POINTS // 2, 3))
    walls = rng.integers(0, len(scene.wall_lower), NUM_POINTS // 2)
    reach = 1.5 * scene.drone_radius
    lower, upper = (np.clip(corners[walls], low, high) for corners in (scene.wall_lower, scene.wall_upper))
    near = rng.uniform(lower - reach, upper + reach)
    return np.concatenate([anywhere, near])


def plain_distance(scene, point):
    """The distance to the nearest point of the nearest box."""
    return min(
        np.linalg.norm(point - np.clip(point, lower, upper))
        for lower, upper in zip(scene.wall_lower, scene.wall_upper, strict=True)
    )


def touches_in_mujoco(scene, points):
    model = copy.deepcopy(scene.model)
    # Without constraints MuJoCo does not look for contacts either.
    off = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.opt.disableflags &= ~int(off)
    data = mujoco.MjData(model)
    touches = []
    for point in points:
        data.qpos[:] = [*point, 1, 0, 0, 0]
        mujoco.mj_fwdPosition(model, data)
        touches.append(bool(np.any(data.contact.dist[: data.ncon] <= 0)))
    return np.array(touches)


@pytest.mark.parametrize("which", ["scene", "other_scene", "plane_scene"])
def test_a_drone_collides_where_mujoco_finds_a_contact(which, request):
    scene = request.getfixturevalue(which)
    points = points_about(scene, seed=0).astype(np.float32)
    distance = np.asarray(jax.jit(lambda p: wall_distance(scene.walls, p))(points))
    expected = np.array([plain_distance(scene, point) for point in points])
    np.testing.assert_allclose(distance, expected, atol=2e-6)  # float32 at 10 m
    certain = np.abs(expected - scene.drone_radius) > TOUCHING
    touches = touches_in_mujoco(scene, points[certain])
    np.testing.assert_array_equal(distance[certain] <= scene.drone_radius, touches)
    assert certain.mean() > 0.99
    assert 0.1 < touches.mean() < 0.9  # both answers were put to the test


def test_distance_keeps_the_shape_of_the_points_and_is_zero_inside(scene):
    centres = jnp.asarray((scene.wall_lower + scene.wall_upper) / 2, jnp.float32).reshape(2, 7, 3)
    np.testing.assert_array_equal(wall_distance(scene.walls, centres), np.zeros((2, 7)))
    assert wall_distance(scene.walls, centres[0, 0]).shape == ()
