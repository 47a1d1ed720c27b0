"""Floor plans: what is drawn can be flown, and their measures are what they say."""

import dataclasses
import itertools
import subprocess
import sys

import mujoco
import numpy as np
import pytest

import pecjax
from pecjax.cli import main
from pecjax.envs.rooms.geodesics import geodesic_lengths, shortest_ways
from pecjax.envs.rooms.map_file import Map
from pecjax.envs.rooms.maps import FAR_AWAY, make_bank
from pecjax.envs.rooms.plans import FAMILIES, Family, make_plans
from pecjax.envs.rooms.plans.check import check_plans
from pecjax.envs.rooms.plans.export import kinds_of_boxes, plan_mjcf
from pecjax.envs.rooms.plans.families import MAX_BOXES, most_boxes
from pecjax.envs.rooms.plans.measures import doors_on_the_way, doorways, measure, plan_paths
from pecjax.envs.rooms.plans.plan_file import read_plans, write_plans
from pecjax.envs.rooms.plans.plans import FLIGHT_HEIGHT, RADIUS
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.validity import check_configurations, free_regions, regions_at

NUMBER = 48


@pytest.fixture(scope="module")
def plans():
    return make_plans(NUMBER, seed=3)


@pytest.fixture(scope="module")
def file(plans, tmp_path_factory):
    path = tmp_path_factory.mktemp("plans") / "plans.npz"
    write_plans(path, plans)
    return path


def as_map(plans, number):
    lower, upper = plans.boxes(number)
    return Map(lower, upper, plans.bounds[number], ("box",) * len(lower))


def equal(one, other):
    assert one.names == other.names
    for a, b in zip(one[:-1], other[:-1], strict=True):
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype


# What is drawn.


def test_plans_depend_on_seed_and_number_alone(plans):
    equal(make_plans(NUMBER, seed=3), plans)
    equal(make_plans(13, seed=3), plans.some(slice(13)))
    other = make_plans(NUMBER, seed=4)
    same = [np.array_equal(a, b) for a, b in zip(other.lower, plans.lower, strict=True)]
    assert not any(same)


@pytest.mark.slow
def test_processes_share_the_work_and_change_nothing(tmp_path):
    script = tmp_path / "both.py"
    script.write_text(
        "from pathlib import Path\nfrom pecjax.envs.rooms.plans import make_plans\n"
        "from pecjax.envs.rooms.plans.check import check_plans\n"
        "from pecjax.envs.rooms.plans.plan_file import write_plans\n"
        "if __name__ == '__main__':\n"
        "    for workers in (1, 2):\n"
        "        plans = make_plans(1010, seed=5, workers=workers)\n"
        "        check_plans(plans, workers)\n"
        "        write_plans(Path(f'{workers}.npz'), plans)\n"
    )
    subprocess.run([sys.executable, script], cwd=tmp_path, check=True, timeout=300)
    assert (tmp_path / "1.npz").read_bytes() == (tmp_path / "2.npz").read_bytes()


def test_families_take_turns(plans):
    assert plans.names == tuple(family.name for family in FAMILIES)
    np.testing.assert_array_equal(plans.family, np.arange(NUMBER) % len(FAMILIES))
    twice = make_plans(6, families=(FAMILIES[0], FAMILIES[1], FAMILIES[0]))
    np.testing.assert_array_equal(twice.family, [0, 1, 0, 0, 1, 0])


def test_boxes_are_whole_centimetres_and_few_enough(plans):
    assert plans.lower.shape == plans.upper.shape == (NUMBER, MAX_BOXES, 3)
    for number in range(NUMBER):
        lower, upper = plans.boxes(number)
        assert 6 <= len(lower) <= MAX_BOXES and np.all(lower < upper)
        for corner in (lower, upper, plans.start[number], plans.goal[number], plans.bounds[number]):
            np.testing.assert_array_equal(np.float32(np.round(100.0 * corner) / 100), corner)
        assert np.all(plans.lower[number, len(lower) :] == np.float32(FAR_AWAY))
        # No two boxes are one, and none lies outside the outer walls.
        assert len(np.unique(np.hstack([lower, upper]), axis=0)) == len(lower)
        low, high = plans.bounds[number]
        assert np.all(lower[:, :2] >= low) and np.all(upper[:, :2] <= high)
    bank = make_bank([as_map(plans, number) for number in range(NUMBER)])
    wide = bank.lower.shape[1]
    np.testing.assert_array_equal(bank.lower, plans.bank.lower[:, :wide])
    np.testing.assert_array_equal(bank.bounds, plans.bank.bounds)


def test_plans_are_made_for_the_drone_of_the_six_rooms(scene):
    assert scene.drone_radius == RADIUS and NavigationSettings().flight_height == FLIGHT_HEIGHT


def test_every_flight_can_be_flown_and_no_plan_can_be_left():
    """By the code that checks everybody's maps; maps of one size, for which it is compiled once."""
    plans = make_plans(18, families=[dataclasses.replace(family, size=(16, 16)) for family in FAMILIES])
    maps = [
        Map(lower, upper, bounds, ("box",) * MAX_BOXES)
        for lower, upper, bounds in zip(plans.lower, plans.upper, plans.bounds, strict=True)
    ]
    table = plans.configurations
    np.testing.assert_array_equal(table.start[1::2], table.goal[::2])
    check_configurations(maps, table, RADIUS, FLIGHT_HEIGHT)
    for number, one in enumerate(maps):
        around = dataclasses.replace(one, bounds=one.bounds + np.float32([[-1], [1]]))
        regions, origin = free_regions(around, RADIUS, FLIGHT_HEIGHT)
        inside = set(regions_at(regions, origin, plans.start[number : number + 1]).ravel()) - {0}
        assert regions[0, 0] > 0 and regions[0, 0] not in inside
        # Nor does a hole lead up or down.
        floor, ceiling = one.upper[:, 2] == 0, one.lower[:, 2] == 2.5
        for slab in (floor, ceiling):
            assert slab.sum() == 1
            np.testing.assert_array_equal(one.lower[slab, :2][0], one.bounds[0])
            np.testing.assert_array_equal(one.upper[slab, :2][0], one.bounds[1])


def test_families_have_what_they_are_named_for(plans):
    kinds = [kinds_of_boxes(*plans.boxes(number)) for number in range(NUMBER)]
    by_name = {
        name: [kinds[i] for i in np.flatnonzero(plans.family == f)] for f, name in enumerate(plans.names)
    }
    assert all(found.count("wall") == 4 and found.count("pillar") >= 5 for found in by_name["hall"])
    assert all(found.count("furniture") >= 4 for found in by_name["furnished"])
    assert any("hanging" in found for found in by_name["furnished"])
    assert all(found.count("wall") > 20 for found in by_name["maze"])
    hall, maze = (plans.some(plans.family == family) for family in (0, len(FAMILIES) - 1))
    assert hall.doors.max() == 0 < np.median(maze.doors)
    assert np.median(hall.detour) < 1.1 < np.median(maze.detour)


# Measures.


def test_no_flight_leads_through_a_gap_that_is_hardly_wider_than_the_drone():
    tight = dataclasses.replace(FAMILIES[2], shelves=(20, 20), pillars=(10, 10))
    found = make_plans(8, families=(tight,))
    assert 0.75 <= found.narrowest.min() < 1.2
    # A drone of nearly that diameter fits through as well.
    for number in range(8):
        lower, upper = found.boxes(number)
        ends = found.start[number : number + 1], found.goal[number : number + 1]
        where = {"radius": 0.34, "flight_height": FLIGHT_HEIGHT, "cell": 0.05}
        assert np.isfinite(geodesic_lengths(lower, upper, found.bounds[number], *ends, **where)).all()


def test_geodesics_lie_between_the_straight_line_and_a_finer_search(plans):
    assert np.all(plans.geodesic >= plans.straight - 1e-5)
    for number in range(12):
        lower, upper = plans.boxes(number)
        ends = plans.start[number : number + 1], plans.goal[number : number + 1]
        where = (lower, upper, plans.bounds[number], *ends)
        (fine,) = geodesic_lengths(*where, radius=RADIUS, flight_height=FLIGHT_HEIGHT, cell=0.05)
        assert 0.97 * fine <= plans.geodesic[number] <= 1.05 * fine
        # A smaller sphere never flies further.
        (small,) = geodesic_lengths(*where, radius=0.1, flight_height=FLIGHT_HEIGHT, cell=0.05)
        assert small <= 1.001 * fine


SHELL = [
    (-0.1, -0.1, -0.1, 8.1, 6.1, 0),
    (-0.1, -0.1, 2.5, 8.1, 6.1, 2.6),
    (-0.1, -0.1, 0, 0.1, 6.1, 2.5),
    (7.9, -0.1, 0, 8.1, 6.1, 2.5),
    (-0.1, -0.1, 0, 8.1, 0.1, 2.5),
    (-0.1, 5.9, 0, 8.1, 6.1, 2.5),
]
BOUNDS = np.float32([[-0.1, -0.1], [8.1, 6.1]])


def hand_made(*boxes):
    corners = np.float32([*SHELL, *boxes]).reshape(-1, 2, 3)
    return corners[:, 0], corners[:, 1]


def length(walls, start, goal, cell=0.1, radius=RADIUS):
    ends = np.float64([start]), np.float64([goal])
    return geodesic_lengths(*walls, BOUNDS, *ends, radius=radius, flight_height=FLIGHT_HEIGHT, cell=cell)[0]


def door_wall(low, high, bottom=0.0, top=2.5):
    return [(3.9, 0, bottom, 4.1, low, top), (3.9, high, bottom, 4.1, 6, top)]


@pytest.mark.parametrize("cell", [0.1, 0.2])
@pytest.mark.parametrize("goal", [(7, 5), (7, 1), (6.03, 2.9), (1.5, 1.1), (1, 1)])
def test_in_an_empty_hall_the_path_is_the_straight_line(goal, cell):
    expected = np.hypot(goal[0] - 1, goal[1] - 1)
    np.testing.assert_allclose(length(hand_made(), (1, 1), goal, cell), expected, rtol=1e-6)


def tangent_path(start, goal, corners, radius):
    """Exact length around convex corners on one side: tangents and arcs of circles."""
    total, points = 0.0, [np.array(start), *map(np.array, corners), np.array(goal)]
    headings = []
    for number, (a, b) in enumerate(itertools.pairwise(points)):
        way, ends = b - a, (number > 0) + (number < len(corners))
        distance = np.hypot(*way)
        total += np.sqrt(distance**2 - radius**2) if ends == 1 else distance
        # From a point to a circle the tangent turns away from the centre.
        turn = np.arcsin(radius / distance) if ends == 1 else 0.0
        headings.append(np.arctan2(way[1], way[0]) + (turn if number == 0 else -turn if ends == 1 else 0))
    turned = sum(abs(b - a) for a, b in itertools.pairwise(headings))
    return total + radius * turned


@pytest.mark.parametrize("cell", [0.05, 0.1, 0.2])
@pytest.mark.parametrize(("start", "goal"), [((2, 1), (6, 1)), ((1, 0.5), (7, 2.5)), ((3, 1.5), (7.5, 0.6))])
def test_around_the_jambs_of_one_door(start, goal, cell):
    """The door lies to the north of both: two tangents, two arcs and the passage between them."""
    walls = hand_made(*door_wall(4, 5))
    exact = tangent_path(start, goal, [(3.9, 4), (4.1, 4)], RADIUS)
    found = length(walls, start, goal, cell)
    assert exact <= found + 1e-6 and found <= 1.028 * exact + 1.5 * cell
    np.testing.assert_allclose(length(walls, goal, start, cell), found, rtol=1e-9)


def test_what_is_flown_over_or_under_makes_no_detour():
    for bottom, top, free in ((0, 0.9, True), (0, 1.0, False), (1.5, 2.5, True), (1.4, 2.5, False)):
        found = length(hand_made((3.9, 0, bottom, 4.1, 4, top)), (2, 1), (6, 1))
        assert bool(found == pytest.approx(4)) == free, (bottom, top)
        assert np.isfinite(found)


def test_where_no_path_leads_there_is_no_length():
    closed = hand_made((3.9, 0, 0, 4.1, 6, 2.5))
    assert length(closed, (2, 1), (6, 1)) == np.inf
    assert length(closed, (2, 1), (2, 5)) == pytest.approx(4)
    slit = hand_made(*door_wall(4, 4.45))
    assert length(slit, (2, 1), (6, 1)) == np.inf
    assert np.isfinite(length(slit, (2, 1), (6, 1), cell=0.05, radius=0.15))
    assert length(hand_made(), (-0.05, 1), (6, 1)) == np.inf  # begins inside a wall
    assert length(hand_made(), (2, 1), (30, 1)) == np.inf
    full = hand_made((0, 0, 0, 8, 6, 2.5))
    assert length(full, (2, 1), (6, 1)) == np.inf


def test_many_pairs_in_the_six_rooms_are_metric(scene):
    draw = np.random.default_rng(0)
    places = pecjax.COORDINATE_SET_2.start[draw.permutation(24)]
    one = scene.map
    where = {"radius": 0.25, "flight_height": 1.2, "cell": 0.2}
    a, b = np.meshgrid(np.arange(12), np.arange(12), indexing="ij")
    ends = places[a.ravel()], places[b.ravel()]
    table = geodesic_lengths(one.lower, one.upper, one.bounds, *ends, **where).reshape(12, 12)
    np.testing.assert_allclose(table, table.T, rtol=1e-6)
    np.testing.assert_allclose(np.diag(table), 0, atol=1e-6)
    around = table[:, :, None] + table[None]
    assert np.all(table[:, None] <= 1.03 * around + 0.2)


def test_a_map_that_is_too_large_is_refused():
    with pytest.raises(pecjax.InputError, match="the most that paths are looked for on"):
        geodesic_lengths(
            np.zeros((1, 3)),
            np.ones((1, 3)),
            np.array([[-1e3, -1e3], [1e3, 1e3]]),
            np.zeros((1, 2)),
            np.ones((1, 2)),
            radius=0.25,
            flight_height=1.2,
        )


def measured(walls, start, goal):
    paths = plan_paths(*walls, BOUNDS)
    (way,) = shortest_ways(paths, np.float64([start]), np.float64([goal]))
    return measure(paths, *walls, way)


@pytest.mark.parametrize("width", [0.8, 1.0, 1.4, 1.8])
def test_the_narrowest_passage_is_the_door(width):
    found = measured(hand_made(*door_wall(4.5 - width / 2, 4.5 + width / 2)), (2.1, 1.1), (6.1, 1.1))
    assert width - 0.2 - 1e-6 <= found.narrowest <= width + 1e-6 and found.doors == 1
    # With its middle on the grid it is found to the centimetre.
    walls = hand_made(*door_wall(4.3 - width / 2, 4.3 + width / 2))
    assert measured(walls, (2.1, 1.1), (6.1, 1.1)).narrowest == pytest.approx(width, abs=0.021)


def test_the_widest_way_counts_not_the_shortest():
    both = [(3.9, 0, 0, 4.1, 1, 2.5), (3.9, 1.8, 0, 4.1, 4.1, 2.5), (3.9, 5.5, 0, 4.1, 6, 2.5)]
    found = measured(hand_made(*both), (2.1, 1.5), (6.1, 1.5))
    assert found.geodesic < 4.2 and found.doors == 1
    assert found.narrowest == pytest.approx(1.4, abs=0.201) and found.narrowest > 1.1


def test_in_the_open_the_floor_is_nearest_and_walls_at_the_ends_are_no_passage():
    assert measured(hand_made(), (4.1, 3.1), (4.3, 3.3)).narrowest == pytest.approx(2.4, abs=0.021)
    assert measured(hand_made(), (0.5, 0.5), (7.5, 5.5)).narrowest > 1.5


def test_doorways_are_gaps_between_walls_on_one_line():
    walls = hand_made(
        *door_wall(2, 3),
        (0, 2.9, 0, 1.5, 3.1, 2.5),
        (2.5, 2.9, 0, 4, 3.1, 2.5),
        (4, 2.9, 0, 8, 3.1, 0.8),  # a low shelf on the same line
    )
    found = doorways(*walls)
    np.testing.assert_allclose(sorted(map(tuple, found.reshape(-1, 4))), [(1.5, 3, 2.5, 3), (4, 2, 4, 3)])
    for points, doors in (
        ([(1.5, 1), (2.5, 5)], 1),
        ([(1, 1), (2, 2.9), (3, 1)], 0),
        ([(2, 5), (2, 1), (6, 4)], 2),
        ([(2, 5), (2, 1), (2, 5)], 1),
        ([(4.5, 1), (6, 5)], 0),
    ):
        assert doors_on_the_way(found, np.float64(points)) == doors, points
    wide = hand_made(*door_wall(2, 4.1))
    assert len(doorways(*wide)) == 0


# Families that cannot be.


ROOMS = FAMILIES[1]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"extra_doors": (2, 3)}, "it asks for 2 extra doors, and 2 by 2 rooms have 1 walls to spare"),
        ({"columns": (2, 7)}, "7 columns in 16 m leave 2.29 m each"),
        ({"rows": (9, 9)}, "9 rows in 16 m"),
        ({"door": (0.5, 1.0)}, "doors are 0.5 m wide; 0.8 m is the least"),
        ({"door": (2.0, 1.0)}, "door is (2.0, 1.0); give numbers that rise"),
        ({"pillars": (-1, 2)}, "pillars is (-1, 2)"),
        ({"size": (float("nan"), 20.0)}, "size is (nan, 20.0)"),
        ({"size": (20.0, 80.0)}, "size is up to 80 m; 50 m is the most"),
        ({"open_share": 1.5}, "open_share is 1.5"),
        ({"columns": (0, 1)}, "it has no rooms"),
        ({"corridor": (0.8, 1.2)}, "corridors are 0.8 m wide"),
        ({"size": (40.0, 40.0), "columns": (8, 8), "rows": (8, 8)}, "its walls may be 86 boxes; 64 is"),
        ({"apart": 60.0}, "no start and goal are 60 m apart"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_family_that_cannot_be_made_is_named_with_its_numbers(changes, words):
    with pytest.raises(pecjax.InputError) as caught:
        make_plans(1, families=(dataclasses.replace(ROOMS, **{"name": "mine", **changes}),))
    assert str(caught.value).startswith("family 'mine' cannot be made: ") and words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_family_of_ones_own():
    tight = Family("tight", size=(16, 16), columns=(6, 6), rows=(6, 6), door=(0.8, 0.8), extra_doors=(9, 9))
    found = make_plans(4, families=(tight,))
    check_plans(found)
    walls = [kinds_of_boxes(*found.boxes(number)).count("wall") for number in range(4)]
    assert max(walls) + 2 <= most_boxes(tight) <= MAX_BOXES


@pytest.mark.parametrize("number", [0, -1, 2**20 + 1])
def test_numbers_that_make_no_sense(number):
    with pytest.raises(pecjax.InputError, match=f"number is {number}"):
        make_plans(number)
    with pytest.raises(pecjax.InputError, match="seed is -1"):
        make_plans(1, seed=-1)
    with pytest.raises(pecjax.InputError, match="no families"):
        make_plans(1, families=())


# Files.


def test_a_file_holds_the_same_plans_and_the_same_bytes(plans, file, tmp_path):
    equal(read_plans(file), plans)
    write_plans(tmp_path / "again.npz", make_plans(NUMBER, seed=3))
    assert (tmp_path / "again.npz").read_bytes() == file.read_bytes()
    assert file.stat().st_size < 900 * NUMBER + 5000


def changed(file, path, **arrays):
    held = dict(np.load(file))
    held |= {f"['{name}']": array for name, array in arrays.items()}
    np.savez(path, **{name: array for name, array in held.items() if array is not None})
    return path


def part(file, name):
    return np.load(file)[f"['{name}']"].copy()


def spoilt(file, name, place, value):
    array = part(file, name)
    array[place] = value
    return array


BAD_ARRAYS = {
    "missing": (lambda f: {"goal": None}, "'goal' is missing"),
    "unknown": (lambda f: {"more": np.zeros(3)}, "'more' is none of theirs"),
    "type": (lambda f: {"lower": part(f, "lower").astype(np.int32)}, "'lower' is (48, 64, 3) int32"),
    "shape": (lambda f: {"start": np.zeros((48, 3), np.int16)}, "'start' is (48, 3) int16"),
    "rank": (lambda f: {"family": np.zeros((48, 1), np.int16)}, "'family' is (48, 1) int16"),
    "number": (lambda f: {"doors": np.zeros(47, np.int16)}, "'doors' is (47,) int16"),
    "box": (lambda f: {"upper": spoilt(f, "upper", (5, 2), -3)}, "plan 5: a box has no size"),
    "far box": (lambda f: {"lower": spoilt(f, "lower", (6, 0), -30000)}, "plan 6: a box has no size or lies"),
    "bounds": (lambda f: {"bounds": spoilt(f, "bounds", 7, 0)}, "plan 7: its bounds are none"),
    "outside": (lambda f: {"goal": spoilt(f, "goal", 8, 4000)}, "plan 8: start or goal lies outside"),
    "one place": (lambda f: {"goal": part(f, "start")}, "plan 0: start and goal are one"),
    "length": (lambda f: {"geodesic": spoilt(f, "geodesic", 3, np.nan)}, "plan 3: a measure is no length"),
    "doors": (lambda f: {"doors": spoilt(f, "doors", 2, -1)}, "plan 2: its number of doors"),
    "family": (lambda f: {"family": spoilt(f, "family", 2, 6)}, "a family that has no name"),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_files_that_hold_no_plans(case, file, tmp_path):
    change, words = BAD_ARRAYS[case]
    path = changed(file, tmp_path / "bad.npz", **change(file))
    with pytest.raises(pecjax.InputError) as caught:
        read_plans(path)
    assert words in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_files_with_changed_bytes(plans, file, tmp_path):
    content, draw = file.read_bytes(), np.random.default_rng(0)
    path = tmp_path / "changed.npz"
    for place in [0, 30, *draw.integers(len(content), size=40)]:
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :])
        try:
            equal(read_plans(path), plans)  # the byte says nothing, such as a date
        except pecjax.InputError as error:
            assert "\n" not in str(error)
    for bad in (b"", b"words", content[:1000], content[:-30]):
        path.write_bytes(bad)
        with pytest.raises(pecjax.InputError, match="cannot be read"):
            read_plans(path)
    with pytest.raises(pecjax.InputError, match="no such file"):
        read_plans(tmp_path / "nowhere.npz")


def test_plans_off_the_centimetre_are_not_written(plans, tmp_path):
    with pytest.raises(pecjax.InputError, match="start holds lengths that are no whole centimetres"):
        write_plans(tmp_path / "p.npz", plans._replace(start=plans.start + np.float32(0.001)))
    assert not list(tmp_path.iterdir())


# What check finds.


WRONG = {
    "geodesic": (lambda p: {"geodesic": p.geodesic + np.float32(0.1)}, "plan 0: its geodesic is"),
    "narrowest": (lambda p: {"narrowest": p.narrowest - np.float32(0.2)}, "plan 0: its narrowest is"),
    "doors": (lambda p: {"doors": p.doors + 1}, "plan 0: its doors is"),
    "a wall": (
        lambda p: {"start": p.start * 0 + np.float32([5, 0.2])},
        "plan 0: its start (5, 0.2) lies 0.10 m",
    ),
    "open": (lambda p: {"lower": np.delete(p.lower, 3, 1), "upper": np.delete(p.upper, 3, 1)}, "not closed"),
    "no floor": (lambda p: {"lower": p.lower[:, 1:], "upper": p.upper[:, 1:]}, "not closed"),
    "no ceiling": (
        lambda p: {"lower": np.delete(p.lower, 1, 1), "upper": np.delete(p.upper, 1, 1)},
        "closed",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_check_finds_what_is_wrong(case, plans):
    some = plans.some(slice(6))
    change, words = WRONG[case]
    with pytest.raises(pecjax.InputError) as caught:
        check_plans(some._replace(**change(some)))
    assert words in str(caught.value)


def test_check_passes_what_was_made(plans):
    check_plans(plans)


# MJCF.


def test_an_exported_plan_is_read_as_it_was(plans, scene, tmp_path):
    for number in (0, 2, 5):
        path = tmp_path / f"{number}.xml"
        path.write_text(plan_mjcf(plans, number))
        read = pecjax.load_scene(path)
        lower, upper = plans.boxes(number)
        np.testing.assert_array_equal(np.float32(read.wall_lower), lower)
        np.testing.assert_array_equal(np.float32(read.wall_upper), upper)
        np.testing.assert_array_equal(np.float32(read.map.bounds), plans.bounds[number])
        assert {"floor", "ceiling", "wall_0", "wall_3"} <= set(read.map.names)
        # The same drone, so that plans and rooms can be maps of one task.
        pecjax.load_scene(path, like=scene.vehicle)
        model = mujoco.MjModel.from_xml_path(str(path))
        assert model.geom("ceiling").rgba[3] < 0.3 and model.geom("floor").rgba[3] == 1
        np.testing.assert_allclose(model.body("drone").pos, [*plans.start[number], 1.2], atol=1e-6)
        assert "ix rooms" not in path.read_text()


def test_an_exported_plan_has_no_marks_of_the_map_whose_drone_it_has(plans, tmp_path):
    base = tmp_path / "base.xml"
    assert main(["new-map", str(base)]) == 0
    assert len(pecjax.load_scene(base).map.starts)
    path = tmp_path / "plan.xml"
    path.write_text(plan_mjcf(plans, 0, base))
    read = pecjax.load_scene(path)
    assert not len(read.map.starts) and not len(read.map.goals)
    np.testing.assert_array_equal(np.float32(read.wall_lower), plans.boxes(0)[0])


def test_starts_and_goals_are_free_in_the_bank_of_a_task(plans):
    from pecjax.envs.rooms.clearance import wall_distance
    from pecjax.envs.rooms.maps import pick

    assert plans.configurations.size == 2 * NUMBER
    for number in (1, 4):
        places = np.float32([[*plans.start[number], 1.2], [*plans.goal[number], 1.2]])
        assert np.all(np.asarray(wall_distance(pick(plans.bank, number), places)) > RADIUS + 0.14)


# The command line.


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pecjax.cli.devices.use_all_cores", lambda: None)
    monkeypatch.setattr("pecjax.cli.devices.keep_compiled_programs", lambda: None)

    def attempt(words):
        code = main(["maps", *words.split()])
        return code, *capsys.readouterr()

    return attempt


def test_make_check_list_draw_and_export(run, plans, tmp_path):
    code, out, _ = run("make --number 12 --seed 3 --out new/p.npz --workers 1")
    assert (code, out) == (0, f"12 plans of {', '.join(plans.names)} in new/p.npz\n")
    equal(read_plans(tmp_path / "new/p.npz"), plans.some(slice(12)))
    code, out, _ = run("check new/p.npz --workers 1")
    assert code == 0 and out.startswith("12 plans: every one is closed")
    code, out, _ = run("list new/p.npz")
    rows = [line.split() for line in out.splitlines()]
    assert code == 0 and [row[:2] for row in rows[1:]] == [[name, "2"] for name in plans.names]
    code, out, _ = run("draw new/p.npz --per-family 2 --out sheet.png")
    assert code == 0 and out.split() == ["sheet.pdf", "sheet.png"]
    assert (tmp_path / "sheet.png").stat().st_size > 20_000
    code, out, _ = run("export new/p.npz --map 5")
    ends = [*plans.start[5], *plans.goal[5]]
    assert code == 0 and out.startswith("plan_5.xml; its flight: ")
    np.testing.assert_allclose([float(word) for word in out.split(": ")[1].split(",")], ends, rtol=1e-5)
    # The rest of pecjax takes it as a map.
    (tmp_path / "pairs.csv").write_text(out.split(": ")[1])
    assert main(["check", "--scene", "plan_5.xml", "--coordinates", "pairs.csv"]) == 0


def test_families_by_name(run, tmp_path):
    code, out, _ = run("make --number 4 --families maze hall --workers 1")
    assert code == 0 and out == "4 plans of maze, hall in plans.npz\n"
    np.testing.assert_array_equal(read_plans(tmp_path / "plans.npz").family, [0, 1, 0, 1])


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("", "no action; give one of make, check, list, draw, export"),
        ("mak", "unknown action 'mak' (did you mean make?)"),
        ("make --numbr 3", "unknown option --numbr (did you mean --number?); pecjax maps make --help"),
        ("make --number x", "--number takes a whole number, not 'x'; pecjax maps make --help"),
        ("make --number 0", "number is 0; 1 to 1,048,576"),
        ("make --seed -1", "seed is -1"),
        ("make --workers 0", "workers is 0"),
        ("make --families", "--families has no value"),
        ("make --families hal", "unknown family 'hal' (did you mean hall?)"),
        ("make 3", "unexpected '3'"),
        ("make --number 1 --workers 1 --out /proc/p.npz", "/proc/p.npz: cannot be written"),
        ("check", "pecjax maps check"),
        ("check nowhere.npz", "nowhere.npz: no such file; make one with pecjax maps make"),
        ("list words.npz", "words.npz: cannot be read"),
        ("draw p.npz --per-family 0", "per-family is 0"),
        ("draw p.npz --per-family 1 --out /proc/sheet", "/proc/sheet"),
        ("export p.npz --map 48", "there is no plan 48; the plans are 0 to 47"),
        ("export p.npz --map -1", "there is no plan -1"),
        ("export p.npz --scene nowhere.xml", "nowhere.xml: no such scene file"),
        ("export p.npz --out /proc/plan.xml", "/proc/plan.xml: cannot be written"),
    ],
)
def test_what_is_refused_gets_one_line(words, complaint, run, file, tmp_path):
    (tmp_path / "words.npz").write_text("words")
    (tmp_path / "p.npz").write_bytes(file.read_bytes())
    before = sorted(tmp_path.rglob("*"))
    code, out, err = run(words)
    assert (code, out) == (2, "") and complaint in err and err.count("\n") == 1
    assert err.startswith("pecjax: ") and sorted(tmp_path.rglob("*")) == before


def test_check_names_file_and_plan(run, plans, tmp_path):
    write_plans(tmp_path / "wrong.npz", plans._replace(doors=plans.doors + (np.arange(NUMBER) == 4)))
    code, _, err = run("check wrong.npz --workers 1")
    assert code == 2 and err.startswith("pecjax: wrong.npz: plan 4: its doors is ")


@pytest.mark.parametrize("words", ["--help", "make --help", "check --help", "export -h"])
def test_help(words, run, capsys):
    with pytest.raises(SystemExit) as stop:
        run(words)
    out, err = capsys.readouterr()
    assert stop.value.code == 0 and "usage: pecjax maps" in out and err == ""
    assert "(default: None)" not in " ".join(out.split())
