"""Banks of maps: what an episode sees and hits is its own map and nothing else."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import OTHER_MAP, extent

import pecjax
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.depth import render_depth
from pecjax.envs.rooms.map_file import Map
from pecjax.envs.rooms.maps import Walls, make_bank, pick
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.rooms.task import RoomsParams

PILLAR = '<geom name="more" type="box" pos="3 2 1" size="0.4 0.3 1"/>'
MAPS = {
    "c.xml": OTHER_MAP.replace("<worldbody>", f"<worldbody>{PILLAR}", 1),
    "a.xml": OTHER_MAP,
    "b.xml": OTHER_MAP.replace('size="0.4 0.4 1" contype="0" conaffinity="0"', 'size="0.4 0.4 1"'),
}
TABLE = "start_x start_y goal_x goal_y map\n2 0.5 5 0 0\n2 0.5 5 0 1\n2 0.5 5 0 2\n-3 0 4.5 3 2\n"
# Of the table's drones the second looks at the box that b.xml has more than a.xml, the third at c.xml's.
LOOKING = np.float32([-0.98, -0.98, 0.98, 0])


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


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


def scenes(folder):
    return [pecjax.load_scene(folder / name) for name in sorted(MAPS)]


def test_maps_of_a_folder_are_counted_in_the_order_of_their_names(made, folder):
    _, world = made
    for number, scene in enumerate(scenes(folder)):
        walls = len(scene.wall_lower)
        np.testing.assert_array_equal(world.params.bank.lower[number, :walls], np.float32(scene.wall_lower))
        np.testing.assert_array_equal(world.params.bank.upper[number, :walls], np.float32(scene.wall_upper))
        np.testing.assert_array_equal(world.params.bank.bounds[number], np.float32(scene.map.bounds))
    assert [len(scene.wall_lower) for scene in scenes(folder)] == [7, 8, 8]
    np.testing.assert_array_equal(world.table.map_id, [0, 1, 2, 2])


@pytest.fixture(scope="module")
def crowd():
    """A map of more walls than any other, of all sizes, in and around one another."""
    draw = np.random.default_rng(0)
    middle, half = draw.uniform(-6, 6, (40, 3)), draw.uniform(0.02, 1, (40, 3))
    lower, upper = middle - half, middle + half
    return Map(lower, upper, np.stack([lower.min(axis=0), upper.max(axis=0)])[:, :2], ("box",) * 40)


def poses_about(low, high, number=300):
    """Places within a box, a little beyond it and far away, and any attitudes."""
    draw = np.random.default_rng(1)
    points = draw.uniform(low - 1, high + 1, (number, 3))
    points[-20:] *= 50
    turns = draw.normal(size=(number, 4))
    return np.float32(points), np.float32(turns / np.linalg.norm(turns, axis=1, keepdims=True))


def test_boxes_that_fill_a_map_up_are_neither_seen_nor_hit(scene, other_scene, plane_scene, crowd):
    one_box = Map(scene.wall_lower[:1], scene.wall_upper[:1], scene.map.bounds, scene.map.names[:1])
    maps = [plane_scene.map, other_scene.map, crowd, scene.map, one_box]
    bank = make_bank(maps)
    assert [len(one.lower) for one in maps] == [7, 7, 40, 14, 1] and bank.lower.shape == (5, 40, 3)
    camera = other_scene.vehicle.camera
    look = jax.jit(jax.vmap(lambda walls, p, q: render_depth(camera, walls, p, q), (None, 0, 0)))
    measure = jax.jit(wall_distance)
    extents = [extent(which) for which in (plane_scene, other_scene)]
    extents += [(one.lower.min(axis=0), one.upper.max(axis=0)) for one in maps[2:]]
    for number, (one, corners) in enumerate(zip(maps, extents, strict=True)):
        points, turns = poses_about(*corners)
        picked, alone = pick(bank, number), Walls(one.lower, one.upper)
        seen = look(alone, points, turns)
        np.testing.assert_array_equal(look(picked, points, turns), seen)
        np.testing.assert_array_equal(measure(picked, points), measure(alone, points))
        assert (seen > camera.near).any() and (seen < camera.far).any()


def test_padding_is_further_away_than_any_wall():
    one = Map(np.full((1, 3), -1e3), np.full((1, 3), -999.0), np.zeros((2, 2)), ("box",))
    two = Map(np.zeros((2, 3)), np.ones((2, 3)), np.zeros((2, 2)), ("box",) * 2)
    walls = pick(make_bank([one, two]), 0)
    points = np.float32([(0, 0, 0), (1e3, 1e3, 1e3), (1e6, 1e6, 1e6)])
    np.testing.assert_allclose(wall_distance(walls, points), np.linalg.norm(points + 999, axis=1), rtol=1e-6)


@pytest.fixture(scope="module")
def programs(made):
    """What an episode is flown with, for several at a time."""
    task, _ = made
    return {
        "place": jax.jit(jax.vmap(task.place)),
        "step": jax.jit(jax.vmap(task.step, (0, 0, 0, None))),
        "observe": jax.jit(jax.vmap(task.observe, (0, 0, None))),
    }


def flown(programs, bank, table, steps=15):
    """Straight ahead from the start: what each episode sees and comes to, step by step."""
    params, keys = RoomsParams(bank), jax.random.split(jax.random.key(0), 4)
    state = programs["place"](jax.tree.map(jnp.asarray, table), LOOKING)
    seen, ends = [programs["observe"](keys, state, params)], []
    for _ in range(steps):
        end = programs["step"](keys, state, jnp.full(4, 12), params)
        state = end.state
        seen.append(programs["observe"](keys, state, params))
        ends.append(end._replace(state=(state.qpos, state.qvel)))
    return [jax.tree.map(lambda *leaves: np.stack(leaves), *rows) for rows in (seen, ends)]


def test_every_episode_flies_in_its_own_map(made, folder, programs):
    """Bit by bit as if there were no other map."""
    _, world = made
    together = flown(programs, world.params.bank, world.table)
    alone = [
        flown(programs, make_bank([scene.map]), world.table.replace(map_id=np.zeros(4, np.int32)))
        for scene in scenes(folder)
    ]
    for row, number in enumerate(world.table.map_id):
        jax.tree.map(
            lambda a, b, row=row: np.testing.assert_array_equal(a[:, row], b[:, row]), together, alone[number]
        )
    # The first map lacks the boxes that the second and the third drone fly into.
    hit, without = (ends.metrics["collision"].any(axis=0) for _, ends in (together, alone[0]))
    assert hit[1] and hit[2] and not without[1] and not without[2]
    for row in (1, 2):
        assert (together[0]["depth"][0, row] != alone[0][0]["depth"][0, row]).mean() > 0.05


def test_another_bank_of_the_same_shape_compiles_nothing(made, folder, programs):
    _, world = made
    first = flown(programs, world.params.bank, world.table)
    compiled = {name: program._cache_size() for name, program in programs.items()}
    a, b, c = (scene.map for scene in scenes(folder))
    for maps in ([c, b, a], [b, b, c]):
        flown(programs, make_bank(maps), world.table, steps=1)
    # The maps in another order, and the table with them: the same flights.
    turned = world.table.replace(map_id=2 - world.table.map_id)
    again = flown(programs, make_bank([c, b, a]), turned)
    jax.tree.map(np.testing.assert_array_equal, again, first)
    assert {name: program._cache_size() for name, program in programs.items()} == compiled


def keep(settings, folder):
    for name, content in settings.files().items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)


def test_what_a_run_keeps_of_its_maps_is_the_same_world(settings, made, tmp_path):
    keep(settings, tmp_path)
    kept = settings.kept_in(tmp_path)
    assert sorted(path.name for path in (tmp_path / "maps").iterdir()) == ["0.xml", "1.xml", "2.xml"]
    jax.tree.map(np.testing.assert_array_equal, kept.make()[1], made[1])
    assert kept.files() == settings.files()


def test_more_than_ten_maps_keep_their_order(folder, tmp_path):
    # A file may stand twice, and files and folders beside one another.
    maps = (str(folder / "c.xml"), str(folder), *[str(folder / "b.xml")] * 8)
    settings = Rooms(table=str(folder / "pairs.txt"), maps=maps)
    keep(settings, tmp_path)
    assert (tmp_path / "maps" / "00.xml").exists() and (tmp_path / "maps" / "11.xml").exists()
    bank = settings.make()[1].params.bank
    jax.tree.map(np.testing.assert_array_equal, settings.kept_in(tmp_path).make()[1].params.bank, bank)
    a, b, c = (scene.map for scene in scenes(folder))
    jax.tree.map(np.testing.assert_array_equal, make_bank([c, a, b, c, *[b] * 8]), bank)


def test_one_map_is_kept_as_one_file(folder, tmp_path):
    one = Rooms(maps=(str(folder / "a.xml"),), table=str(tmp_path / "one.txt"))
    (tmp_path / "one.txt").write_text("-2 0 5 0\n")
    assert set(one.files()) == {"scene.xml", "coordinates.csv"}
    keep(one, tmp_path)
    jax.tree.map(np.testing.assert_array_equal, one.kept_in(tmp_path).make()[1], one.make()[1])


def test_critics_are_told_of_the_drone_where_its_place_says_where_the_walls_are(folder, made):
    """In several maps a place says nothing of walls, and critics see what the policy sees."""
    task, _ = made
    assert task.privileged_space is None
    assert Rooms().make()[0].privileged_space is not None


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


@pytest.mark.parametrize("number", [1, -1])
def test_a_table_in_memory_that_names_no_map_is_refused(number, scene):
    table = pecjax.COORDINATE_SET_1.replace(map_id=np.int32([0] * 7 + [number] * 13))
    with pytest.raises(pecjax.InputError, match=f"configuration 7: there is no map {number}; .* 0 to 0"):
        pecjax.check_coordinates(scene, table, flight_height=1.2)


FREE = '<joint type="free" {}/>'
OTHER_DRONES = {
    "mass": ('mass="0.9"', 'mass="0.8"'),
    "inertia": ('diaginertia="0.008', 'diaginertia="0.007'),
    "radius": ('size="0.18"', 'size="0.17"'),
    "timestep": ('timestep="0.01"', 'timestep="0.02"'),
    "rotors": ('ctrlrange="0 6"', 'ctrlrange="0 7"'),
    "camera": ('resolution="20 11"', 'resolution="20 12"'),
    "gravity": ('timestep="0.01"', 'timestep="0.01" gravity="1 0 -9.81"'),
    "wind": ('timestep="0.01"', 'timestep="0.01" density="1.2" wind="3 0 0"'),
    "density": ('timestep="0.01"', 'timestep="0.01" density="1.2"'),
    "viscosity": ('timestep="0.01"', 'timestep="0.01" viscosity="0.1"'),
    "flags": ('timestep="0.01"/>', 'timestep="0.01"><flag gravity="disable"/></option>'),
    "damping": ("<freejoint/>", FREE.format('damping="1"')),
    "armature": ("<freejoint/>", FREE.format('armature="1"')),
    "stiffness": ("<freejoint/>", FREE.format('stiffness="1"')),
    "gravcomp": ('<body name="drone"', '<body name="drone" gravcomp="0.5"'),
}


@pytest.mark.parametrize("part", OTHER_DRONES)
def test_maps_with_another_drone_are_refused(part, folder, tmp_path):
    other = OTHER_MAP.replace(*OTHER_DRONES[part])
    assert other != OTHER_MAP
    (tmp_path / "odd.xml").write_text(other)
    maps = (str(folder / "a.xml"), str(tmp_path / "odd.xml"))
    refused(f"odd.xml: its drone differs in {part} from", table=str(folder / "pairs.txt"), maps=maps)


def test_the_same_drone_may_stand_elsewhere_in_each_map(folder, tmp_path):
    moved = OTHER_MAP.replace('name="drone" pos="-2 0 1"', 'name="drone" pos="3.3 2.7 1.1" euler="0 0 33"')
    assert moved != OTHER_MAP
    (tmp_path / "moved.xml").write_text(moved)
    maps = (str(folder / "a.xml"), str(tmp_path / "moved.xml"), str(folder / "b.xml"))
    _, world = Rooms(table=str(folder / "pairs.txt"), maps=maps).make()
    np.testing.assert_array_equal(world.params.bank.lower[0], world.params.bank.lower[1])


def test_a_spring_that_pulls_elsewhere_is_another_drone(folder, tmp_path):
    sprung = OTHER_MAP.replace("<freejoint/>", FREE.format('stiffness="1"'))
    (tmp_path / "a.xml").write_text(sprung)
    (tmp_path / "b.xml").write_text(sprung.replace('name="drone" pos="-2 0 1"', 'name="drone" pos="3 2 1"'))
    refused("b.xml: its drone differs in spring from", table=str(folder / "pairs.txt"), maps=(str(tmp_path),))


def test_a_folder_without_maps_is_refused(tmp_path):
    (tmp_path / "map.txt").write_text(OTHER_MAP)
    refused(f"{tmp_path}: no MJCF file (*.xml) in this folder", maps=(str(tmp_path),))
    refused("nowhere.xml: no such scene file", maps=(str(tmp_path / "nowhere.xml"),))


def test_a_map_without_a_free_place_is_refused(folder, tmp_path):
    block = '<geom name="block" type="box" pos="1 0 1.5" size="5 4 1.5"/>'
    (tmp_path / "full.xml").write_text(OTHER_MAP.replace("<worldbody>", f"<worldbody>{block}", 1))
    maps = (str(folder / "a.xml"), str(folder / "b.xml"), str(tmp_path / "full.xml"))
    refused(
        "line 4: configuration 2: start (2, 0.5) lies inside a wall",
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


def test_a_notice_says_which_of_the_maps_is_open(folder, tmp_path):
    east = '<geom name="east" type="box" pos="6 0 1.5" size="1.5 4 0.1" euler="0 90 0"/>'
    assert east in OTHER_MAP
    (tmp_path / "open.xml").write_text(OTHER_MAP.replace(east, ""))
    (tmp_path / "pairs.txt").write_text(TABLE.replace("5 0 1", "4 0 1"))  # where there still is a map
    for maps, expected in (("a", "open", "c"), 1), (("a", "b", "c"), 0):
        paths = [str((tmp_path if name == "open" else folder) / f"{name}.xml") for name in maps]
        settings = Rooms(table=str(tmp_path / "pairs.txt"), maps=tuple(paths))
        lines = settings.notices(*settings.make())
        assert len(lines) == expected and all("map 1 has no closed outer walls" in line for line in lines)
