from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest
from flax import struct
from hypothesis import given, settings, strategies
from hypothesis.extra.numpy import arrays
from jax import numpy as jnp

import pecjax
from pecjax.envs.axes import axis, fill
from pecjax.envs.configuration_files import table_text
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.clearance_grid import make_grid
from pecjax.envs.rooms.notices import map_notices
from pecjax.envs.rooms.validity import free_regions

HEIGHT = 1.2
SET_1, SET_2 = pecjax.COORDINATE_SET_1, pecjax.COORDINATE_SET_2
DOORS = {
    "west to north-west": ((-5.0, 1.0), ("north_a", "north_b")),
    "hall to north-east": ((-1.0, 1.0), ("north_b", "north_c")),
    "hall to south-east": ((2.7, -4.0), ("south_a", "south_b")),
    "west to hall": ((-6.2, -1.0), ("west_a", "west_b")),
    "south-west to south-east": ((-3.0, -5.5), ("south_divider_a", "south_divider_b")),
}
ROOMS = {
    "north-west": (-6, 5), "north-east": (3, 5), "west": (-8, -2),
    "hall": (0, -2), "south-west": (-6, -7), "south-east": (3, -7),
}  # fmt: skip
PLUGS = {
    "west to north-west": "-5 1 1.25", "hall to north-east": "-1 1 1.25", "hall to south-east": "2.7 -4 1.25",
    "west to hall": "-6.2 -1 1.25", "south-west to south-east": "-3 -5.5 1.25",
}  # fmt: skip


def plug(door):
    """The edit of rooms.xml that walls a door up."""
    wall = f'<geom class="wall" name="plug {door}" pos="{PLUGS[door]}" size="0.7 0.7 1.25"/>'
    return ("<light", wall + "<light")


def world_notices(scene, table):
    return map_notices([scene.map], fill(table), scene.vehicle, pecjax.NavigationSettings())


def check(scene, *rows):
    table = np.array(rows, np.float32)
    pecjax.check_coordinates(scene, pecjax.Configurations(table[:, :2], table[:, 2:]), flight_height=HEIGHT)


@pytest.fixture(scope="module")
def clearance(scene):
    """table -> the least distance to a wall, m, along each row's straight line from start to goal."""

    @jax.jit
    def distance(starts, goals):
        along = jnp.linspace(0, 1, 2001)[:, None, None]
        points = starts + along * (goals - starts)
        level = jnp.full((*points.shape[:2], 1), HEIGHT)
        return wall_distance(scene.walls, jnp.concatenate([points, level], axis=-1)).min(axis=0)

    return lambda table: np.asarray(distance(table.start, table.goal))


@pytest.mark.parametrize(("table", "size"), [(SET_1, 20), (SET_2, 24)])
def test_every_odd_row_is_the_reverse_of_the_even_one_before(table, size):
    assert table.size == size
    assert table.start.shape == table.goal.shape == (size, 2)
    np.testing.assert_array_equal(table.start[1::2], table.goal[::2])
    np.testing.assert_array_equal(table.goal[1::2], table.start[::2])


@pytest.mark.parametrize(
    ("table", "row", "start", "goal"),
    [
        (SET_1, 0, (0, -2), (5, -2)),
        (SET_1, 3, (-1, 4), (-1, 0)),
        (SET_1, 10, (-5, -5), (-8, -8)),
        (SET_1, 15, (3, -2), (3, -5)),  # the paper's misprint, put right
        (SET_1, 18, (-8, -2), (6, -2)),
        (SET_2, 0, (-7, -8), (-1, -8)),
        (SET_2, 7, (5, -2), (0, 5)),
        (SET_2, 14, (5, -7), (2, -1)),
        (SET_2, 20, (-5, 5), (0, -2)),
        (SET_2, 23, (5, 0), (-7, 0)),
    ],
)
def test_rows_are_those_of_the_paper(table, row, start, goal):
    np.testing.assert_array_equal(table.start[row], start)
    np.testing.assert_array_equal(table.goal[row], goal)


def test_set_1_is_the_easy_one(clearance, scene):
    clear = clearance(SET_1) > scene.drone_radius
    assert set(np.flatnonzero(~clear)) == {12, 13, 18, 19}
    tightest = np.where(clear, clearance(SET_1), np.inf)
    np.testing.assert_allclose(tightest[[14, 15]], 0.40, atol=1e-3)
    assert np.all(np.delete(tightest, [14, 15]) > 0.41)


def test_set_2_is_the_hard_one(clearance, scene):
    assert np.all(clearance(SET_2) <= scene.drone_radius)


@pytest.mark.parametrize("table", [SET_1, SET_2])
def test_both_sets_can_be_flown(scene, table):
    pecjax.check_coordinates(scene, table, flight_height=HEIGHT)


def regions(scene):
    """room -> number of the connected region it lies in."""
    labels, origin = free_regions(scene.map, scene.drone_radius, HEIGHT)
    cell = {room: np.round((np.array(place) - origin) / 0.05).astype(int) for room, place in ROOMS.items()}
    return {room: int(labels[tuple(at)]) for room, at in cell.items()}


def test_six_rooms_are_joined_as_a_tree(scene, edited_rooms):
    joined = regions(scene)
    assert set(joined.values()) == {joined["hall"]} and joined["hall"] > 0
    for door in DOORS:
        # A tree falls into two parts wherever it is cut; a loop would hold together.
        cut = regions(pecjax.load_scene(edited_rooms(plug(door))))
        assert len(set(cut.values())) == 2, door
        one, other = door.split(" to ")
        assert cut[one] != cut[other], door


def test_rooms_connect_only_through_doors(edited_rooms):
    closed = regions(
        pecjax.load_scene(edited_rooms(("<light", "".join(plug(d)[1][:-6] for d in DOORS) + "<light")))
    )
    assert len(set(closed.values())) == 6 and 0 not in closed.values()


def test_loads_the_papers_sets_by_number():
    assert pecjax.load_coordinates("1") is SET_1
    assert pecjax.load_coordinates(2) is SET_2


def test_loads_a_file_with_commas_blanks_and_comments(tmp_path):
    path = tmp_path / "pairs.txt"
    path.write_text("# start, goal\n0, -2, 5, -2\n\n  1e0 -2.5\t.5  -1  # back\r\n-3,4 -1,4\n")
    table = pecjax.load_coordinates(path)
    np.testing.assert_array_equal(table.start, np.float32([(0, -2), (1, -2.5), (-3, 4)]))
    np.testing.assert_array_equal(table.goal, np.float32([(5, -2), (0.5, -1), (-1, 4)]))
    assert table.start.dtype == np.float32


HEADERS = [
    "start_x,start_y,goal_x,goal_y",
    "goal_x goal_y start_x start_y",
    "Goal_Y, start_x, GOAL_X,start_y",
]


@pytest.mark.parametrize("mark", ["", "# ", "#", "\ufeff"])
@pytest.mark.parametrize("header", HEADERS)
def test_a_header_says_which_column_is_which(header, mark, tmp_path):
    path = tmp_path / "pairs.csv"
    rows = np.float32([(0, -2, 5, -2), (1, 2.5, -3, 4)])
    names = header.lower().replace(",", " ").split()
    frame = pd.DataFrame(rows, columns=["start_x", "start_y", "goal_x", "goal_y"])[names]
    lines = frame.to_csv(index=False, header=False)
    path.write_text(
        f"\n# rooms\n{mark}{header}  \n{lines}" if "\ufeff" not in mark else f"{mark}{header}\n{lines}"
    )
    table = pecjax.load_coordinates(path)
    np.testing.assert_array_equal(np.hstack([table.start, table.goal]), rows)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (
            "start_x,start_y,goal_x,gaol_y",
            "line 2, column 4: 'gaol_y' is unknown (did you mean goal_y?); the columns are start_x",
        ),
        ("# start_x,start_y,goal_x,gaol_y", "pairs.csv, line 2, column 4: 'gaol_y' is unknown"),
        ("name,start_x,start_y,goal_x,goal_y", "line 2, column 1: 'name' is unknown"),
        ("start_x,start_y,goal_x,start_x", "line 2, column 4: 'start_x' stands twice"),
        ("start_x,start_y,goal_x", "line 2: no column goal_y"),
    ],
)
def test_a_header_that_is_wrong_is_refused(header, message, tmp_path):
    path = tmp_path / "pairs.csv"
    path.write_text(f"\n{header}\n0,-2,5,-2\n")
    with pytest.raises(pecjax.InputError) as caught:
        pecjax.load_coordinates(path)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_row_of_a_file_is_named_by_its_line(scene, tmp_path):
    path = tmp_path / "pairs.csv"
    path.write_text("# pairs\n\nstart_x,start_y,goal_x,goal_y\n0,-2,5,-2\n\n0,-2,7.7,-2\n")
    table = pecjax.load_coordinates(path)
    with pytest.raises(pecjax.InputError, match=r"pairs\.csv, line 6: configuration 1: goal \(7.7, -2\)"):
        pecjax.check_coordinates(scene, table, flight_height=HEIGHT, source=path)


@struct.dataclass
class Narrow(pecjax.Configurations):
    view: Any = axis("view", default=1.0, low=0, high=1)


def test_a_row_with_an_axis_of_ones_own_is_named_likewise(scene, tmp_path):
    path = tmp_path / "narrow.csv"
    path.write_text("start_x,start_y,goal_x,goal_y,view\n0,-2,7.7,-2,0.5\n")
    table = pecjax.load_coordinates(path, Narrow)
    with pytest.raises(pecjax.InputError, match=r"narrow\.csv, line 2: configuration 0: goal \(7.7, -2\)"):
        pecjax.check_coordinates(scene, table, flight_height=HEIGHT, source=path)


OUTER_EAST = '<geom class="wall" name="outer_east" pos="8 -1 1.25" size="0.1 9.1 1.25"/>'
NOTICES = {
    "nothing": ([], []),
    "no timestep": ([('timestep="0.02" ', "")], ["timestep is 0.002 s (MuJoCo's default"]),
    "a fine timestep": ([('timestep="0.02"', 'timestep="0.005"')], ["timestep is 0.005 s: 20 physics steps"]),
    "a timestep that is fine enough": ([('timestep="0.02"', 'timestep="0.01"')], []),
    "a wall is missing": ([(OUTER_EAST, "")], ["no closed outer walls"]),
    "a plane in place of a wall": (
        [(OUTER_EAST, '<geom type="plane" size="0 0 1" pos="7.9 0 0" zaxis="-1 0 0"/>')],
        [],
    ),
    "a floor": ([("<light", '<geom type="plane" size="0 0 1"/><light')], []),
}


@pytest.mark.parametrize("case", NOTICES)
def test_what_is_seldom_meant_gets_a_notice(case, edited_rooms):
    edits, expected = NOTICES[case]
    found = world_notices(pecjax.load_scene(edited_rooms(*edits)), SET_1)
    assert len(found) == len(expected), found
    for line, words in zip(found, expected, strict=True):
        assert words in line and "\n" not in line


def test_a_goal_that_is_reached_at_once_gets_a_notice(scene):
    rows = np.float32([(0, -2, 5, -2), (0, -2, 0.3, -2.1), (0, 0, 0, 0.5), (0, 0, 0.1, 0)])
    table = pecjax.Configurations(rows[:, :2], rows[:, 2:])
    pecjax.check_coordinates(scene, table, flight_height=HEIGHT)
    (line,) = world_notices(scene, table)
    assert "configuration 1: the goal is 0.32 m from the start" in line and "so it is in 1 more" in line
    # To hold a goal takes time wherever the episode begins.
    held = table.replace(objective=np.array([0, 1, 1, 1], np.int32))
    assert world_notices(scene, held) == ()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "neither 1 nor 2 nor a file"),
        (b"", "no configurations"),
        (b"# nothing\n\n", "no configurations"),
        (b"0,0,1,1\nstart, goal\n", "line 2: 'start, goal'"),
        (b"0,0,1\n", "line 1: '0,0,1'"),
        (b"0,0,1,1,1\n", "line 1"),
        (b"\n0,0,nan,1\n", "line 2"),
        (b"0,inf,1,1\n", "line 1"),
        (b"0,1e39,1,1\n", "line 1"),  # infinite once it is a float32
        (b"\x00\x01\xff\xfe\x80" * 20, "pairs.txt"),
        (b"\x00" * 64, "pairs.txt"),
    ],
)
def test_a_bad_file_is_refused(tmp_path, content, message):
    path = tmp_path / "pairs.txt"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(pecjax.InputError) as caught:
        pecjax.load_coordinates(path)
    assert message in str(caught.value)
    assert "pairs.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


GOOD = (0, -2, 5, -2)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ((7.9, -2, 5, -2), r"configuration 1: start \(7.9, -2\) lies inside a wall"),
        ((5, -2, 7.7, -2), r"configuration 1: goal \(7.7, -2\) lies 0.20 m from a wall"),
        ((11, -2, 5, -2), r"configuration 1: start \(11, -2\) lies outside the map"),
        ((5, -2, 0, -60), r"configuration 1: goal \(0, -60\) lies outside the map"),
        ((5, -2, 5, -2), r"configuration 1: start and goal are both \(5, -2\)"),
    ],
)
def test_a_row_that_cannot_be_flown_is_named(scene, row, message):
    check(scene, GOOD)
    with pytest.raises(pecjax.InputError, match=message):
        check(scene, GOOD, row)


def test_a_walled_off_room_is_noticed(edited_rooms):
    scene = pecjax.load_scene(edited_rooms(plug("hall to north-east")))
    check(scene, GOOD, (0, 5, 5, 5))
    with pytest.raises(pecjax.InputError, match=r"configuration 1: no path .*\(-1, 0\) to \(-1, 4\)"):
        check(scene, GOOD, (-1, 0, -1, 4))


@pytest.mark.parametrize(("width", "fits"), [(0.4, False), (0.49, False), (0.6, True), (0.8, True)])
def test_a_door_must_let_the_drone_through(edited_rooms, width, fits):
    # The door of the hall to the north-east, x in [-1.7, -0.3], narrowed from the east.
    east = -1.7 + width
    narrow = f'name="north_c" pos="{(east + 8) / 2} 1 1.25" size="{(8 - east) / 2} 0.1 1.25"'
    scene = pecjax.load_scene(edited_rooms(('name="north_c" pos="3.85 1 1.25" size="4.15 0.1 1.25"', narrow)))
    if fits:
        check(scene, (-1, -1, -1, 4))
    else:
        with pytest.raises(pecjax.InputError, match=r"configuration 0: no path of 0\.5 m width"):
            check(scene, (-1, -1, -1, 4))


def test_a_point_that_counts_as_a_collision_is_refused(scene):
    # The task ends where the distance is at most the radius; 7.65 leaves 0.25 m to the east wall.
    x = np.float32(7.65)
    gap = wall_distance(scene.walls, jnp.array([x, -2, HEIGHT]))
    assert gap <= scene.drone_radius
    with pytest.raises(pecjax.InputError, match="configuration 0: start"):
        check(scene, (x, -2, 5, -2))


tables = arrays(
    np.float32,
    strategies.tuples(strategies.integers(1, 40), strategies.just(4)),
    elements=strategies.floats(-1000, 1000, width=32),
)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(tables)
def test_any_table_reads_back_from_its_file_as_it_was(tmp_path_factory, numbers):
    path = tmp_path_factory.mktemp("tables") / "pairs.csv"
    path.write_text(table_text(pecjax.Configurations(start=numbers[:, :2], goal=numbers[:, 2:])))
    table = pecjax.load_coordinates(path)
    np.testing.assert_array_equal(np.hstack([table.start, table.goal]), numbers)
    assert table.size == len(numbers)


@settings(deadline=None, derandomize=True, max_examples=200)
@given(strategies.text(max_size=60))
def test_any_text_is_a_table_or_is_refused_in_one_line(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("texts") / "pairs.csv"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        assert np.isfinite(pecjax.load_coordinates(path).start).all()
    except pecjax.InputError as error:
        assert str(path) in str(error) and "\n" not in str(error)


def test_clearance_on_a_grid_is_the_distance_to_the_walls(scene):
    """At every cell of the six rooms, up to the reach; reachability and shortest paths rest on it."""
    one = scene.map
    grid = make_grid(one.lower, one.upper, one.bounds, flight_height=1.2, cell=0.1, reach=0.6)
    cells = np.stack(np.meshgrid(*map(np.arange, grid.clearance.shape), indexing="ij"), axis=-1)
    places = np.concatenate([grid.origin + 0.1 * cells, np.full((*cells.shape[:2], 1), 1.2)], axis=-1)
    expected = np.minimum(np.asarray(wall_distance(scene.walls, places.astype(np.float32))), 0.6)
    np.testing.assert_allclose(grid.clearance, expected, atol=1e-5)
