"""Named spaces: what is in them is what they say, and nothing held out is trained in."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from jax import numpy as jnp

import pecjax
from pecjax.cli import main
from pecjax.envs.axes import make_table
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.config import VIA
from pecjax.envs.rooms.controller import Command
from pecjax.envs.rooms.default_drone import default_scene_path
from pecjax.envs.rooms.flight import Conditions, fly, hover
from pecjax.envs.rooms.maps import MapBank, Walls
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.rooms.spaces import catalogue, weather
from pecjax.envs.rooms.spaces.elsewhere import evaluated_rooms
from pecjax.envs.rooms.spaces.features import features
from pecjax.envs.rooms.spaces.pairs import draw_pairs, make_site, table_lengths
from pecjax.envs.rooms.spaces.space import Part, Space, check_held_out, shared_rows
from pecjax.envs.rooms.spaces.space_file import read_space, space_path, write_space
from pecjax.envs.rooms.validity import check_coordinates

QUICK = ("paper-1", "paper-2", "rooms-longtail")


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """Where named spaces are kept while the tests run."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def in_cache(cache, monkeypatch):
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(cache))


@pytest.fixture(scope="session")
def made():
    """name -> the space, made once."""
    found = {}

    def get(name):
        if name not in found:
            found[name] = catalogue.make_space(name)
        return found[name]

    return get


@pytest.fixture(scope="session")
def site(scene):
    return make_site(scene.map, scene.drone_radius, 1.2)


def part_of(start, goal, group=None, **axes):
    table = make_table(pecjax.Configurations, start=np.array(start), goal=np.array(goal), **axes)
    number = table.size
    group = np.zeros(number, np.int32) if group is None else np.array(group, np.int32)
    return Part(table, group, np.linalg.norm(table.goal - table.start, axis=1).astype(np.float32))


def small_space(name="small", held_out=((0, -3), (1, -3)), **changes):
    train = part_of([[0, -2], [-5, 0], [-1, 0]], [[5, -2], [-5, 5], [-1, 4]], [0, 1, 0])
    other = part_of(held_out, [[5, -3]] * len(held_out), [0, 1])
    return Space(name, "for tests", ("short", "long"), train, other)._replace(**changes)


@pytest.mark.parametrize("name", QUICK)
def test_a_named_space_is_the_one_that_its_version_names(name, made):
    assert made(name).version == catalogue.RECIPES[name].version
    check_held_out(made(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in catalogue.RECIPES if name not in QUICK])
def test_the_other_named_spaces_are_those_that_their_versions_name(name, made):
    assert made(name).version == catalogue.RECIPES[name].version
    check_held_out(made(name))


@pytest.mark.parametrize("split", ["train", "held-out"])
@pytest.mark.parametrize("name", QUICK)
def test_every_configuration_of_the_six_rooms_can_be_flown(name, split, made, scene):
    check_coordinates(scene, made(name).part(split).table, flight_height=1.2)


def test_the_long_tail_is_what_it_says(made, scene):
    """Sight against clearance at 200 places of each straight flight; 95 % and 5 %."""
    space = made("rooms-longtail")
    assert np.bincount(space.train.group).tolist() == [1900, 100]
    for part in (space.train, space.held_out):
        start, goal = np.asarray(part.table.start), np.asarray(part.table.goal)
        share = np.linspace(0, 1, 200)[:, None, None]
        places = start + share * (goal - start)
        heights = np.full((*places.shape[:2], 1), 1.2)
        gaps = np.asarray(wall_distance(scene.walls, jnp.asarray(np.concatenate([places, heights], -1))))
        nearest, hard = gaps.min(axis=0), part.group == 1
        assert (nearest[~hard] > scene.drone_radius - 1e-5).all()
        # Between two of the places a corner may come a little nearer.
        assert (nearest[hard] <= scene.drone_radius + 0.02).all()
        assert (np.linalg.norm(goal - start, axis=1)[hard] > 8).all()
        assert (part.shortest >= np.linalg.norm(goal - start, axis=1) - 1e-3).all()
        np.testing.assert_allclose(
            part.shortest[~hard], np.linalg.norm(goal - start, axis=1)[~hard], atol=2e-3
        )


def test_of_the_papers_places_other_pairs_are_held_out(made):
    table = made("paper-1").train.table
    np.testing.assert_array_equal(table.start, pecjax.COORDINATE_SET_1.start)
    places = {tuple(place) for place in np.concatenate([table.start, table.goal]).tolist()}
    other = made("paper-1").held_out.table
    assert {tuple(place) for place in np.concatenate([other.start, other.goal]).tolist()} <= places


def test_shared_rows_are_found_whatever_is_left_out():
    one = make_table(
        pecjax.Configurations, start=np.zeros((3, 2)), goal=np.array([[1, 1], [2, 2], [-0.0, 3]])
    )
    other = make_table(
        pecjax.Configurations,
        start=np.zeros((2, 2)),
        goal=np.array([[2, 2], [0, 3]]),
        payload=np.array([0, 0.1]),
    )
    assert shared_rows(one, other).tolist() == [1]  # no payload is a payload of nothing
    assert shared_rows(other, one).tolist() == [0]


@pytest.mark.parametrize("speed", [0.0, 3.0, 6.0, 9.0, 12.0])
def test_into_the_wind_the_drone_is_as_fast_as_the_formula_says(speed, scene):
    """Flown by the controller and MJX, straight ahead at full speed, with a payload."""
    settings = NavigationSettings()
    conditions = Conditions(jnp.array([-speed, 0, 0]), settings.drag, jnp.float32(0.3), None)
    far = Walls(np.full((1, 3), 1e6, np.float32), np.full((1, 3), 1e6 + 1, np.float32))
    command = Command(jnp.float32(2.0), jnp.float32(0), 1.2)
    state = hover(jnp.array([0.0, 0, 1.2]), jnp.float32(0))
    flown, _ = jax.jit(lambda s: fly(scene.vehicle, far, settings.gains, s, command, 400, conditions))(state)
    expected = weather.upwind_speed(scene.vehicle, settings, np.array([speed]))[0]
    assert abs(float(flown.qvel[0]) - expected) < 0.15
    assert (expected < 0) == (speed > 8.6)


def test_what_lies_beyond_cannot_be_reached_and_the_rest_is_sorted_by_wind(scene):
    draw = np.random.default_rng(0)
    number = 500
    table = make_table(
        pecjax.Configurations,
        start=draw.uniform(-5, 5, (number, 2)),
        goal=draw.uniform(-5, 5, (number, 2)),
        **weather.draw_weather(draw, number),
    )
    group = weather.groups_of(table, scene.vehicle, NavigationSettings())
    speed = np.linalg.norm(table.wind, axis=1)
    beyond = group == weather.GROUPS.index("beyond")
    assert 10 < beyond.sum() < number / 4
    upwind = -np.sum((table.goal - table.start) * table.wind[:, :2], axis=1) / np.maximum(speed, 1e-9)
    assert (upwind[beyond] > 1.5).all() and (speed[beyond] > 8.6).all()
    assert (group[~beyond] == np.digitize(speed, [4, 8])[~beyond]).all()


@pytest.mark.slow
def test_no_flight_gets_to_what_lies_beyond(made, scene):
    """Straight towards the goal, straight into the wind, or 45° off it: over 30 s none comes near."""
    table, group = made("rooms-storm").train.table, made("rooms-storm").train.group
    rows = np.flatnonzero(group == weather.GROUPS.index("beyond"))[:60]
    settings = NavigationSettings()
    far = Walls(np.full((1, 3), 1e6, np.float32), np.full((1, 3), 1e6 + 1, np.float32))

    def nearest(start, goal, wind, payload, off):
        into = jnp.arctan2(-wind[1], -wind[0]) + off
        state = hover(jnp.concatenate([start, jnp.array([1.2])]), into)
        conditions = Conditions(wind, settings.drag, payload, None)

        def step(state, _):
            command = Command(jnp.float32(2.0), jnp.float32(0), 1.2)
            state, _ = fly(scene.vehicle, far, settings.gains, state, command, 5, conditions)
            return state, jnp.linalg.norm(state.qpos[:2] - goal)

        return jax.lax.scan(step, state, length=300)[1].min()

    flown = jax.jit(jax.vmap(nearest, (0, 0, 0, 0, None)))
    of = [
        jnp.asarray(np.asarray(getattr(table, name))[rows]) for name in ("start", "goal", "wind", "payload")
    ]
    for off in (0.0, np.pi / 4, -np.pi / 4):
        assert (np.asarray(flown(*of, off)) > settings.goal_radius).all()


def test_by_way_of_a_waypoint_both_legs_count(site):
    pairs = draw_pairs(site, np.random.default_rng(1), 30, lambda distance, in_sight: distance > 3)
    part = catalogue._objectives(site, np.random.default_rng(2), pairs)
    via = np.asarray(part.table.objective) == VIA
    start, goal, waypoint = (np.asarray(getattr(part.table, name)) for name in ("start", "goal", "waypoint"))
    legs = np.linalg.norm(waypoint - start, axis=1) + np.linalg.norm(goal - waypoint, axis=1)
    assert via.sum() == 10 and (part.shortest[via] >= legs[via] - 1e-3).all()
    np.testing.assert_allclose(part.shortest[~via], pairs.shortest[~via])
    np.testing.assert_allclose(table_lengths(site, part.table), part.shortest)


def test_a_file_reads_back_as_the_same_space_and_is_the_same_bytes(tmp_path):
    corners = np.full((2, 3, 3), 1e9, np.float32)
    corners[:, :2] = np.arange(12).reshape(2, 2, 3) / 100
    bank = MapBank(corners, corners, np.zeros((2, 2, 2), np.float32))
    space = small_space(maps=bank)
    write_space(tmp_path / "a.npz", space)
    write_space(tmp_path / "b.npz", space)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    again = read_space(tmp_path / "a.npz")
    assert again.version == space.version and again.groups == space.groups
    jax.tree.map(np.testing.assert_array_equal, again.maps, space.maps)
    jax.tree.map(np.testing.assert_array_equal, again.train, space.train)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda arrays: arrays.pop("train/goal_x"), "no column goal_x"),
        (lambda arrays: arrays.update({"train/start_x": arrays["train/start_x"] + 1}), "not .* as it says"),
        (lambda arrays: arrays.update({"train/start_x": arrays["train/start_x"] * np.nan}), "train row 0"),
        (lambda arrays: arrays.update({"train/group": arrays["train/group"] + 9}), "groups, lengths or maps"),
        (
            lambda arrays: arrays.update({"train/group": arrays["train/group"][:1]}),
            "tables of several lengths",
        ),
        (lambda arrays: arrays.pop("about"), "no file of a space"),
        (lambda arrays: arrays.update({"about": np.frombuffer(b"[]", np.uint8)}), "no file of a space"),
        (lambda arrays: arrays.update({"maps/lower": np.zeros((1, 2, 3))}), "no file of a space"),
    ],
)
def test_a_file_that_holds_something_else_gets_one_line(change, said, tmp_path):
    path = tmp_path / "space.npz"
    write_space(path, small_space())
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    change(arrays)
    with path.open("wb") as file:
        np.savez(file, **arrays)
    with pytest.raises(pecjax.InputError, match=said):
        read_space(path)


def test_a_truncated_file_and_none_get_one_line(tmp_path):
    path = tmp_path / "space.npz"
    with pytest.raises(pecjax.InputError, match="no such file"):
        read_space(path)
    write_space(path, small_space())
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(pecjax.InputError, match="cannot be read"):
        read_space(path)


def test_what_is_held_out_and_trained_in_is_refused(tmp_path):
    space = small_space()
    both = space._replace(held_out=space.train)
    with pytest.raises(pecjax.InputError, match="3 held-out configurations are in its training table"):
        check_held_out(both)
    write_space(tmp_path / "both.npz", both)
    with pytest.raises(pecjax.InputError, match="in its training table too"):
        read_space(tmp_path / "both.npz")


@pytest.fixture
def rooms(tmp_path):
    write_space(tmp_path / "small.npz", small_space())
    return Rooms(space=str(tmp_path / "small.npz"))


def test_a_task_trains_in_one_part_and_is_evaluated_in_the_other(rooms, tmp_path):
    world = rooms.make()[1]
    about = rooms.eval_set(world)
    space = small_space()
    np.testing.assert_array_equal(world.table.start, space.train.table.start)
    np.testing.assert_array_equal(about.table.start, space.held_out.table.start)
    assert about.held_out and about.groups == ("short", "long")
    np.testing.assert_allclose(about.shortest, space.held_out.shortest - 0.5)
    for name, content in rooms.files().items():
        (tmp_path / name).write_bytes(content)
    kept = rooms.kept_in(tmp_path)
    jax.tree.map(np.testing.assert_array_equal, kept.make()[1], world)


def test_in_another_map_the_way_is_not_known_and_what_is_held_out_must_fly(rooms, edited_rooms):
    wider = replace(rooms, maps=(str(edited_rooms(('pos="-6.2 0.35 1.25"', 'pos="-6.2 0.45 1.25"'))),))
    same = replace(rooms, maps=(str(default_scene_path()),))
    assert same.eval_set(same.make()[1]).shortest is not None
    assert wider.eval_set(wider.make()[1]).shortest is None
    write_space(Path(rooms.space), small_space(held_out=((0, -3), (-6.2, 0.35))))
    with pytest.raises(pecjax.InputError, match=r"configuration 1: start .* lies inside a wall"):
        replace(rooms, maps=same.maps).make()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"table": "2"}, "leave out --coordinates"),
        ({"maps": ("a.xml",)}, "a.xml: no such scene file"),
        ({"maps": (str(default_scene_path()),) * 2}, "takes one map, .*; give one with --scene, not 2"),
        ({"flight_height": 1.0}, "the spaces are made for 1.2 m"),
        ({"space": "rooms-pair"}, r"did you mean rooms-pairs\?"),
        ({"space": "nowhere.npz"}, "no such file"),
    ],
)
def test_what_does_not_go_together_gets_one_line(rooms, changes, said):
    with pytest.raises(pecjax.InputError, match=said):
        replace(rooms, **changes).make()


def test_a_named_space_is_made_once_and_kept(cache, monkeypatch):
    path = space_path("paper-1")
    assert path.is_relative_to(cache) and read_space(path).name == "paper-1"
    monkeypatch.setattr("pecjax.envs.rooms.spaces.space_file.make_space", None)
    assert space_path("paper-1") == path


def test_where_a_policy_is_evaluated(rooms, tmp_path):
    own = evaluated_rooms(rooms, rooms.make()[1])[1]
    assert own.held_out and own.table.size == 2
    assert not evaluated_rooms(rooms, rooms.make()[1], split="train")[1].held_out
    of_table = evaluated_rooms(rooms, rooms.make()[1], coordinates="2")[1]
    assert of_table.table.size == 24 and not of_table.held_out
    assert (
        of_table.shortest > np.linalg.norm(of_table.table.goal - of_table.table.start, axis=1) - 0.51
    ).all()
    plain = Rooms()
    assert evaluated_rooms(plain, plain.make()[1])[1].table.size == 20
    assert evaluated_rooms(plain, plain.make()[1], space=rooms.space)[1].table.size == 2
    trained = Space("set-1", "", ("all",), part_of([[7, 7]], [[1, 2]]), part_of([[0, -2]], [[5, -2]]))
    write_space(tmp_path / "trained.npz", trained)
    with pytest.raises(pecjax.InputError, match="1 of the held-out configurations are in the run's training"):
        evaluated_rooms(plain, plain.make()[1], space=str(tmp_path / "trained.npz"))


def test_a_door_that_the_grid_is_too_coarse_for_costs_only_the_spl(tmp_path):
    plan = tmp_path / "narrow.txt"  # doors of 0.6 m between cells of 0.2 m, for a drone of 0.5 m
    plan.write_text("cell 0.6\n#######\n#.....#\n#S....#\n###.###\n#G....#\n#######\n")
    rooms = Rooms(maps=(str(plan),))
    about = evaluated_rooms(rooms, rooms.make()[1])[1]
    assert about.shortest is None and about.table.size == 1


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"split": "test"}, "give train or held-out"),
        ({"space": "paper-1", "coordinates": "2"}, "a space has maps and configurations of its own"),
        ({"split": "train", "coordinates": "2"}, "give --space too"),
    ],
)
def test_where_a_policy_cannot_be_evaluated(rooms, asked, said):
    with pytest.raises(pecjax.InputError, match=said):
        evaluated_rooms(rooms, rooms.make()[1], **asked)


def test_another_version_of_a_runs_space_is_refused(rooms, tmp_path):
    other = small_space(held_out=((0, -3.5), (1, -3)))
    write_space(tmp_path / "later.npz", other)
    with pytest.raises(pecjax.InputError, match=f"version {other.version} .* {small_space().version}"):
        evaluated_rooms(rooms, rooms.make()[1], space=str(tmp_path / "later.npz"))


def test_features_are_what_varies():
    part = part_of([[0, 0], [0, 0]], [[3, 4], [6, 8]], wind=np.array([[3, 4, 0], [0, 0, 0]]), gust=np.ones(2))
    found = features(part.table)
    assert set(found) == {"straight distance (m)", "wind (m/s)"}
    np.testing.assert_allclose(found["wind (m/s)"], [5, 0])


def test_a_drone_of_ones_own_flies_in_a_space(rooms, edited_rooms, tmp_path):
    """In the maps of the space; where it has none, in the drone's own map, if that can be flown."""
    heavy = edited_rooms(('mass="1.477"', 'mass="1.6"'))
    own = replace(rooms, maps=(str(heavy),))
    assert own.make()[0].vehicle.mass == pytest.approx(1.6)
    closed = edited_rooms(
        (
            'name="north_b" pos="-3 1 1.25" size="1.3 0.1 1.25"',
            'name="north_b" pos="-2 1 1.25" size="2.3 0.1 1.25"',
        )
    )
    write_space(tmp_path / "through.npz", small_space(train=part_of([[0, -2]], [[3, 5]])))
    with pytest.raises(pecjax.InputError, match=r"configuration 0: no path"):
        Rooms(space=str(tmp_path / "through.npz"), maps=(str(closed),)).make()
    corners = np.array([[[-9, -9, 0], [9, 9, 3]]], np.float32)
    bank = MapBank(corners[:, :1], corners[:, 1:], np.array([[[-9, -9], [9, 9]]], np.float32))
    write_space(tmp_path / "mapped.npz", small_space(maps=bank))
    wide = edited_rooms(('name="drone" type="sphere" size="0.25"', 'name="drone" type="sphere" size="0.3"'))
    with pytest.raises(pecjax.InputError, match=r"radius of 0.3 m; the maps of space"):
        Rooms(space=str(tmp_path / "mapped.npz"), maps=(str(wide),)).make()


def test_spaces_are_listed_described_checked_and_drawn(tmp_path, capsys):
    assert main(["spaces"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == [*catalogue.RECIPES]
    assert main(["spaces", "paper-1", "--check", "--out", str(tmp_path / "drawn")]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"paper-1 {catalogue.RECIPES['paper-1'].version}: ") and "made anew it is" in out
    assert "  train: 20 configurations\n" in out and "  held-out: 308 configurations\n" in out
    assert {path.name for path in tmp_path.iterdir()} == {"drawn.pdf", "drawn.png"}
    assert main(["spaces", "--check"]) == 2
    assert "--check and --out are of one space; give its name" in capsys.readouterr().err


def test_a_space_that_is_made_otherwise_today_is_told(tmp_path, capsys):
    former = small_space(name="paper-1")
    write_space(tmp_path / "former.npz", former)
    assert main(["spaces", str(tmp_path / "former.npz"), "--check"]) == 2
    said = (
        f"version {former.version}, and this version of pecjax makes {catalogue.RECIPES['paper-1'].version}"
    )
    assert said in capsys.readouterr().err


def test_a_space_is_put_in_place_whole(cache):
    """Nothing of the making is left beside it."""
    path = space_path("paper-2")
    assert [other.name for other in path.parent.iterdir() if other.name.startswith(".")] == []
