"""Depth among many walls: those out of view are left out, and nobody can tell."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from floors import floor_plan
from test_depth import seen_by_mujoco

import pecjax
from pecjax.envs.rooms import depth
from pecjax.envs.rooms.clearance import least_distance, wall_distance
from pecjax.envs.rooms.controller import Command, ControllerGains
from pecjax.envs.rooms.flight import fly, hover
from pecjax.envs.rooms.map_file import ENDLESS
from pecjax.envs.rooms.maps import Walls, make_bank, pick
from pecjax.envs.rooms.plans import make_plans
from pecjax.envs.rooms.plans.export import plan_mjcf
from pecjax.envs.rooms.rotations import quaternion_to_matrix
from pecjax.envs.rooms.scene import default_scene_path
from pecjax.envs.rooms.visibility import any_left, could_be_seen, pack, take_first

TOLERANCE = 2e-3  # m
EDGE_FRACTION = 0.002  # of rays may graze an edge, and pass on the other side of it in float32
KINDS = ({}, {"lids": False}, {"uneven": True}, {"lids": False, "uneven": True})


def plan(seed):
    """One after the other: with floor and ceiling or without, walls of one height or of several."""
    return floor_plan(seed, **KINDS[seed % 4])


def poses(number, seed):
    """Places in and a little beyond a plan, half of them tilted anyhow, half of them nearly level."""
    draw = np.random.default_rng(seed)
    places = draw.uniform((-11, -11, -1), (11, 11, 4), (number, 3))
    places[number // 2 :, 2] = 1.2
    turns = draw.normal(size=(number, 4))
    yaw, tilt = draw.uniform(-np.pi, np.pi, number), draw.normal(0, 0.1, (2, number))
    level = np.stack([np.cos(yaw / 2), *tilt, np.sin(yaw / 2)], axis=-1)
    turns[number // 2 :] = level[number // 2 :]
    return np.float32(places), np.float32(turns / np.linalg.norm(turns, axis=1, keepdims=True))


def against_all_walls(camera, walls, position, quaternion):
    """The depth image, cast against every wall of the map."""
    rotation = quaternion_to_matrix(quaternion)
    local = jnp.asarray(depth.pixel_directions(camera).reshape(-1, 3).T, jnp.float32)
    origin = position + rotation @ jnp.asarray(camera.position, jnp.float32)
    found = depth.raycast(walls, origin, rotation @ local)
    return jnp.clip(found, camera.near, camera.far).reshape(camera.height, camera.width)


def both_ways(camera):
    """The program that makes the images both ways, of many poses in one map."""

    def look(walls, position, quaternion):
        return (
            depth.render_depth(camera, walls, position, quaternion),
            against_all_walls(camera, walls, position, quaternion),
        )

    return jax.jit(jax.vmap(look, (None, 0, 0)))


def assert_alike(ours, theirs):
    """The same but for rays that graze an edge: the two programs round differently."""
    off = np.abs(np.asarray(ours) - theirs) > 1e-4
    assert off.mean() < 1e-5, f"{off.sum()} of {off.size} pixels"


def test_no_wall_is_missed_in_any_plan(scene):
    camera = scene.vehicle.camera
    look, seen = both_ways(camera), []
    for seed in range(24):
        one = plan(seed)
        ours, theirs = look(Walls(np.float32(one.lower), np.float32(one.upper)), *poses(400, seed))
        assert_alike(ours, theirs)
        seen.append(ours)
    far = (np.array(seen) == camera.far).mean()
    assert 0.02 < far < 0.7 and len(np.unique(np.round(seen, 2))) > 500


@pytest.mark.parametrize("which", ["other_scene", "plane_scene"])
def test_no_wall_is_missed_by_a_camera_that_looks_down_nor_before_endless_planes(which, request):
    scene = request.getfixturevalue(which)
    one = floor_plan(3, lids=False)
    walls = Walls(*(np.float32(np.concatenate(both)) for both in zip(
        (one.lower, one.upper), (scene.wall_lower, scene.wall_upper), strict=True
    )))  # fmt: skip
    assert len(walls.lower) == 71 and (which == "other_scene") == (np.abs(walls.lower).max() < ENDLESS)
    assert_alike(*both_ways(scene.vehicle.camera)(walls, *poses(600, 0)))


@pytest.mark.parametrize("resolution", [(2, 1), (1, 7), (9, 2)])
def test_images_of_few_pixels_miss_no_wall(resolution):
    scene, one = pecjax.load_scene(resolution=resolution), floor_plan(1)
    walls = Walls(np.float32(one.lower), np.float32(one.upper))
    assert_alike(*both_ways(scene.vehicle.camera)(walls, *poses(300, 1)))


def test_most_walls_are_left_out(scene):
    one = floor_plan(0)
    places, turns = poses(600, 2)

    def number(place, turn):
        seen = could_be_seen(
            scene.vehicle.camera, quaternion_to_matrix(turn), one.lower - place, one.upper - place
        )
        return seen.sum()

    numbers = np.asarray(jax.jit(jax.vmap(number))(places, turns))
    assert len(one.lower) == 64 and numbers.mean() < 24 and numbers.min() < 6


@pytest.mark.parametrize("number", [1, 31, 32, 33, 70])
def test_flags_are_taken_one_after_the_other(number):
    draw = np.random.default_rng(number)
    for flags in (draw.random(number) < 0.4, np.zeros(number, bool), np.ones(number, bool)):
        words, taken = pack(jnp.asarray(flags)), []
        while any_left(words):
            words, one = take_first(words, jnp.int32(-1))
            taken.append(int(one))
        np.testing.assert_array_equal(taken, np.flatnonzero(flags))
        assert take_first(words, jnp.int32(-1))[1] == -1


def map_file(one, path, default):
    """The map as an MJCF file, with the drone of the six rooms."""
    spec = mujoco.MjSpec.from_file(str(default))
    for geom in list(spec.worldbody.geoms):
        spec.delete(geom)
    for number, (low, high) in enumerate(zip(one.lower, one.upper, strict=True)):
        spec.worldbody.add_geom(
            name=f"box {number}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=(low + high) / 2, size=(high - low) / 2
        )
    spec.compile()
    path.write_text(spec.to_xml())
    return path


def off_from_mujoco(scene, number, seed):
    """Pixels (N, H, W) that differ from what `mj_ray` sees, at poses that are not inside a wall."""
    places, turns = poses(number * 2, seed)
    places[:, :2] += scene.map.bounds.mean(axis=0)
    free = np.flatnonzero(jax.jit(wall_distance)(scene.walls, places) > 0.15)
    chosen = np.random.default_rng(seed).permutation(free)[:number]
    places, turns = places[chosen], turns[chosen]
    camera = scene.vehicle.camera
    expected = np.array([
        seen_by_mujoco(scene.model, *pose, camera.near, camera.far)
        for pose in zip(places, turns, strict=True)
    ])  # fmt: skip
    images = jax.jit(jax.vmap(lambda p, q: pecjax.depth_image(scene, p, q)))(places, turns)
    return np.abs(images - expected) > TOLERANCE


@pytest.mark.parametrize("seed", range(4))
def test_plans_look_as_mujoco_sees_them(seed, tmp_path):
    scene = pecjax.load_scene(map_file(plan(seed), tmp_path / "map.xml", default_scene_path()))
    assert len(scene.wall_lower) == 64
    off = off_from_mujoco(scene, 12, seed)
    assert off.mean() <= EDGE_FRACTION, f"{off.sum()} of {off.size} pixels"


@pytest.mark.slow
def test_fifty_plans_look_as_mujoco_sees_them(tmp_path):
    off, plans = [], make_plans(50, seed=3)
    for number in range(plans.size):
        path = tmp_path / f"{number}.xml"
        path.write_text(plan_mjcf(plans, number))
        scene = pecjax.load_scene(path)
        off.append(off_from_mujoco(scene, 200, number))
    pixels = np.concatenate([each.ravel() for each in off])
    print(f"{pixels.sum()} of {pixels.size} pixels graze an edge")
    assert len(off) == 50 and pixels.mean() <= EDGE_FRACTION / 10


def test_the_least_distance_from_many_walls_is_that_of_all_places(scene):
    one, (places, _) = plan(0), poses(500, 0)
    walls = Walls(one.lower, one.upper)
    places = places.reshape(100, 5, 3)
    expected = jax.jit(wall_distance)(walls, places).min(axis=1)
    found = jax.jit(jax.vmap(least_distance, (None, 0)))(walls, places)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert (found == 0).any() and (found > 0.2).any()


@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_a_flight_among_many_walls_is_that_among_few(scene, speed):
    """The six rooms' walls twice over are the same walls, and more than few."""
    twice = Walls(*(np.concatenate([corners] * 2) for corners in scene.walls))
    before, command = hover(jnp.array([7.2, -2.0, 1.2]), jnp.array(0.1)), Command(speed, 0.5, 1.2)
    program = jax.jit(lambda walls: fly(scene.vehicle, walls, ControllerGains(), before, command, 30))
    (state, nearest), (many_state, many_nearest) = program(scene.walls), program(twice)
    np.testing.assert_allclose(many_state.qpos, state.qpos, atol=1e-5)
    np.testing.assert_allclose(many_nearest, nearest, atol=1e-5)
    assert nearest < 0.8


def test_few_walls_are_cast_against_in_one_piece(scene, monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr(depth, "raycast_in_view", never)
    places, turns = poses(1, 0)
    pecjax.depth_image(scene, places[0], turns[0])
    one = floor_plan(0)
    sixteen, more = (Walls(one.lower[:n], one.upper[:n]) for n in (16, 17))
    depth.render_depth(scene.vehicle.camera, sixteen, places[0], turns[0])
    with pytest.raises(AssertionError):
        depth.render_depth(scene.vehicle.camera, more, places[0], turns[0])


def test_other_plans_of_as_many_boxes_compile_nothing(scene):
    camera = scene.vehicle.camera
    program = jax.jit(
        jax.vmap(lambda bank, n, p, q: depth.render_depth(camera, pick(bank, n), p, q), (None, 0, 0, 0))
    )
    places, turns = poses(8, 0)
    banks = [make_bank([plan(seed) for seed in seeds]) for seeds in ((0, 1), (2, 3))]
    together = [program(bank, np.arange(8) % 2, places, turns) for bank in banks]
    assert program._cache_size() == 1 and np.any(together[0] != together[1])
    # Every drone in its own map, whatever the others of the batch have in view.
    alone = jax.jit(lambda walls, p, q: depth.render_depth(camera, walls, p, q))
    for row in range(8):
        one = plan(row % 2)
        walls = Walls(np.float32(one.lower), np.float32(one.upper))
        np.testing.assert_allclose(together[0][row], alone(walls, places[row], turns[row]), atol=1e-4)
