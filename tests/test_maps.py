"""Banks of maps: what an episode sees and hits is its own map and nothing else."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import OTHER_MAP

import pecjax
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.depth import render_depth
from pecjax.envs.rooms.maps import MapBank, make_bank, pick
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.task import take_configs

PILLAR = '<geom name="more" type="box" pos="3 2 1" size="0.4 0.3 1"/>'
MAPS = {
    "c.xml": OTHER_MAP.replace("<worldbody>", f"<worldbody>{PILLAR}", 1),
    "a.xml": OTHER_MAP,
    "b.xml": OTHER_MAP.replace('size="0.4 0.4 1" contype="0" conaffinity="0"', 'size="0.4 0.4 1"'),
}
TABLE = "start_x start_y goal_x goal_y map\n1.5 -1 5 0 0\n1.5 -1 5 0 1\n1.5 -1 5 0 2\n-3 0 4.5 3 2\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    for name, text in MAPS.items():
        (folder / name).write_text(text)
    (folder / "pairs.txt").write_text(TABLE)
    return folder


@pytest.fixture(scope="module")
def settings(folder):
    return Rooms(table=str(folder / "pairs.txt"), maps=(str(folder),))


@pytest.fixture(scope="module")
def made(settings):
    return settings.make()


def scenes(folder):
    return [pecjax.load_scene(folder / name) for name in sorted(MAPS)]


def test_maps_of_a_folder_are_counted_in_the_order_of_their_names(made, folder):
    _, world = made
    for number, scene in enumerate(scenes(folder)):
        walls = len(scene.wall_lower)
        np.testing.assert_array_equal(world.params.bank.lower[number, :walls], np.float32(scene.wall_lower))
        np.testing.assert_array_equal(world.params.bank.upper[number, :walls], np.float32(scene.wall_upper))
        np.testing.assert_array_equal(world.params.bank.bounds[number], np.float32(scene.map.bounds))
    assert [len(scene.wall_lower) for scene in scenes(folder)] == [8 - 1, 8, 8]
    np.testing.assert_array_equal(world.table.map_id, [0, 1, 2, 2])


def test_boxes_that_fill_a_map_up_are_neither_seen_nor_hit(made, folder):
    task, world = made
    draw = np.random.default_rng(0)
    points = draw.uniform((-3.5, -3.5, 0.2), (5.5, 3.5, 2.5), (200, 3)).astype(np.float32)
    turns = draw.normal(size=(200, 4))
    turns = np.float32(turns / np.linalg.norm(turns, axis=1, keepdims=True))
    camera = task.vehicle.camera
    look = jax.jit(jax.vmap(lambda walls, p, q: render_depth(camera, walls, p, q), (None, 0, 0)))
    for number, scene in enumerate(scenes(folder)):
        picked, alone = pick(world.params.bank, number), scene.walls
        np.testing.assert_array_equal(look(picked, points, turns), look(alone, points, turns))
        np.testing.assert_array_equal(wall_distance(picked, points), wall_distance(alone, points))


def test_every_episode_flies_in_its_own_map(made, folder):
    task, world = made
    key = jax.random.key(0)
    looking = jnp.zeros(4)
    states = jax.vmap(task.place)(jax.tree.map(jnp.asarray, world.table), looking)
    seen = jax.vmap(task.sense, (0, None))(states, world.params)["depth"]
    for row, scene in enumerate(scenes(folder)[n] for n in (0, 1, 2, 2)):
        state = jax.tree.map(lambda leaf, row=row: leaf[row], states)
        alone = pecjax.depth_image(scene, state.qpos[:3], state.qpos[3:])
        np.testing.assert_allclose(seen[row], alone, atol=1e-4)
    # The box of the second map stands in the way of its drone alone.
    step = jax.jit(jax.vmap(task.step, (None, 0, 0, None)))
    ended = np.zeros(4, int)
    for n in range(40):
        after = step(key, states, jnp.full(4, 12), world.params)
        states = after.state
        ended = np.where((ended == 0) & np.asarray(after.metrics["collision"]), n + 1, ended)
    assert 0 < ended[1] < ended[0] and ended[0] == ended[2]


def test_another_bank_of_the_same_shape_compiles_nothing(made):
    task, world = made
    step = jax.jit(task.step)
    state = task.place(jax.tree.map(jnp.asarray, take_configs(world.table, 0)), jnp.float32(0))
    moved = MapBank(*(leaf + np.float32(0.01) for leaf in world.params.bank))
    for bank in (world.params.bank, moved):
        step(jax.random.key(0), state, jnp.int32(12), world.params._replace(bank=bank))
    assert step._cache_size() == 1


def test_what_a_run_keeps_of_its_maps_is_the_same_world(settings, made, tmp_path):
    (tmp_path / "maps").mkdir()
    for name, text in settings.files().items():
        (tmp_path / name).write_text(text)
    assert sorted(path.name for path in (tmp_path / "maps").iterdir()) == ["0.xml", "1.xml", "2.xml"]
    jax.tree.map(np.testing.assert_array_equal, settings.kept_in(tmp_path).make()[1], made[1])


def test_one_map_is_kept_as_one_file(folder, tmp_path):
    one = Rooms(maps=(str(folder / "a.xml"),), table=str(tmp_path / "one.txt"))
    (tmp_path / "one.txt").write_text("-2 0 5 0\n")
    for name, text in one.files().items():
        (tmp_path / name).write_text(text)
    jax.tree.map(np.testing.assert_array_equal, one.kept_in(tmp_path).make()[1], one.make()[1])


def refused(message, **changes):
    with pytest.raises(pecjax.InputError) as caught:
        Rooms(**changes).make()
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_map_that_is_not_there_is_named_with_its_line(folder, tmp_path):
    (tmp_path / "pairs.txt").write_text(TABLE + "-2 0 5 0 3\n")
    where = str(tmp_path / "pairs.txt")
    refused(
        "pairs.txt, line 6: configuration 4: there is no map 3; the maps are 0 to 2",
        table=where,
        maps=(str(folder),),
    )
    (tmp_path / "pairs.txt").write_text(TABLE + "-2 0 5 0 -1\n")
    refused("pairs.txt, line 6, column 5: map is -1", table=where, maps=(str(folder),))


def test_maps_with_another_drone_are_refused(folder, tmp_path):
    (tmp_path / "heavy.xml").write_text(OTHER_MAP.replace('mass="0.9"', 'mass="0.8"'))
    maps = (str(folder / "a.xml"), str(tmp_path / "heavy.xml"))
    refused("heavy.xml: its drone differs in mass", table=str(folder / "pairs.txt"), maps=maps)


def test_a_folder_without_maps_is_refused(tmp_path):
    refused("no MJCF file (*.xml) in this folder", maps=(str(tmp_path),))


def test_a_map_without_a_free_place_is_refused(folder, tmp_path):
    block = '<geom name="block" type="box" pos="1 0 1.5" size="5 4 1.5"/>'
    (tmp_path / "full.xml").write_text(OTHER_MAP.replace("<worldbody>", f"<worldbody>{block}", 1))
    maps = (str(folder / "a.xml"), str(folder / "b.xml"), str(tmp_path / "full.xml"))
    refused(
        "line 4: configuration 2: start (1.5, -1) lies inside a wall",
        table=str(folder / "pairs.txt"),
        maps=maps,
    )


def test_padding_keeps_the_order_of_the_walls():
    one = type("Map", (), {"lower": np.zeros((2, 3)), "upper": np.ones((2, 3)), "bounds": np.eye(2)})
    two = type("Map", (), {"lower": np.ones((1, 3)), "upper": 2 * np.ones((1, 3)), "bounds": np.eye(2)})
    bank = make_bank([one, two])
    assert bank.lower.shape == (2, 2, 3) and bank.lower.dtype == np.float32
    np.testing.assert_array_equal(bank.lower[1, 0], np.ones(3))
    np.testing.assert_array_equal(bank.lower[1, 1], bank.upper[1, 1])
