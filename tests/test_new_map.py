"""Maps of one's own: written anew, drawn with characters, or walls alone; and what check says of them."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import OTHER_MAP
from hypothesis import given, settings as with_settings, strategies as st

import pecjax
from pecjax.cli import main
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.mjcf_file import read_map_file
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.rooms.text_plan import merge, read_text_plan
from pecjax.runtime import devices

DOCS = (Path(__file__).parents[1] / "docs/maps.md").read_text()


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(devices, "use_all_cores", lambda: None)
    monkeypatch.setattr(devices, "keep_compiled_programs", lambda: None)
    return tmp_path


def scene_of(text, name="plan.txt", **options):
    Path(name).write_text(text)
    return pecjax.load_scene(name, **options)


# New maps.


@pytest.mark.parametrize("name", ["my_rooms.xml", "my_plan.txt"])
def test_a_new_map_passes_check_and_says_what_to_type_next(name, capsys):
    assert main(["new-map", name]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{name}: three rooms, with 2 starts and 2 goals")
    assert [line.strip() for line in lines[1:]] == [
        f"pecjax check --scene {name}",
        f"pecjax train --scene {name}",
    ]
    assert main(lines[1].split()[1:]) == 0
    out, err = capsys.readouterr()
    assert "4 configurations: every one can be flown" in out and err == ""
    assert {path.stem for path in Path().iterdir()} == {"check", Path(name).stem} and Path(
        "check.png"
    ).exists()


def test_the_drone_of_a_new_map_is_that_of_the_six_rooms(scene):
    assert main(["new-map", "my_rooms.xml"]) == 0
    new = pecjax.load_scene("my_rooms.xml", like=scene.vehicle)  # refuses another one
    assert new.notices == () and "<!-- Looks along +x" in Path("my_rooms.xml").read_text()


def test_nothing_is_overwritten(capsys):
    Path("my_rooms.xml").write_text("mine")
    for name, words in (
        ("my_rooms.xml", "my_rooms.xml: is there already; give another name"),
        ("my_rooms", "my_rooms: a map ends in .xml or .txt"),
        ("my_rooms.xml/plan.txt", "cannot be written"),
    ):
        assert main(["new-map", name]) == 2
        out, err = capsys.readouterr()
        assert out == "" and words in err and err.count("\n") == 1
    assert [path.read_text() for path in Path().iterdir()] == ["mine"]


def trained(name, *options):
    assert (
        main(["train", "--scene", name, *options, "--iterations", "1", "--num-envs", "8", "--out", "run"])
        == 0
    )
    Path(name).unlink()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["my_rooms.xml", "my_plan.txt"])
def test_a_new_map_trains_with_one_command(name, capsys):
    assert main(["new-map", name]) == 0
    trained(name)
    assert "notice" not in capsys.readouterr().err
    assert main(["eval", "run", "--episodes", "4"]) == 0
    assert len(re.findall(r"^  c\d ", capsys.readouterr().out, re.M)) == 4


@pytest.mark.slow
def test_walls_alone_train_and_say_what_was_added(capsys):
    write("my_walls.xml", blocks("xml")[0])
    trained("my_walls.xml", "--task.approximate", "0.1")
    told = [line for line in capsys.readouterr().err.splitlines() if "notice: " in line]
    assert len(told) == 2 and "the drone of the six rooms is added" in told[0]
    assert "boxes along the axes stand for geom 5" in told[1]
    assert main(["train", "--resume", "--out", "run", "--iterations", "2"]) == 0
    assert "notice" not in capsys.readouterr().err


# Plans drawn with characters.

PLAN = """// a comment
cell 0.4
height: 3

######
#S..G#
#.####
#..G#
######

"""


def test_a_plan_is_read_as_it_is_drawn():
    scene = scene_of(PLAN)
    np.testing.assert_allclose(scene.map.bounds, [(0, 0), (2.4, 2)], atol=1e-9)
    assert set(scene.wall_lower[:, 2]) == {0} and set(scene.wall_upper[:, 2]) == {3}
    np.testing.assert_allclose(scene.map.starts, [(0.6, 1.4)])
    np.testing.assert_allclose(scene.map.goals, [(1.8, 1.4), (1.4, 0.6)])
    for row, line in enumerate(PLAN.splitlines()[4:9]):
        for column, character in enumerate(line.ljust(6)):
            middle = jnp.float32([0.4 * (column + 0.5), 0.4 * (4.5 - row), 1])
            assert (wall_distance(scene.walls, middle) == 0) == (character == "#"), (row, column)


@given(st.tuples(st.integers(1, 9), st.integers(1, 9)), st.data())
@with_settings(deadline=None, max_examples=200)
def test_rectangles_cover_the_walls_and_nothing_else(shape, data):
    flags = st.lists(st.booleans(), min_size=shape[0] * shape[1], max_size=shape[0] * shape[1])
    walls = np.array(data.draw(flags)).reshape(shape)
    covered = np.zeros_like(walls)
    for (top, left), (bottom, right) in merge(walls):
        assert walls[top:bottom, left:right].all()
        assert not covered[top:bottom, left:right].all()
        covered[top:bottom, left:right] = True
    np.testing.assert_array_equal(covered, walls)


def test_rectangles_are_few():
    frame = np.ones((20, 30), bool)
    frame[1:-1, 1:-1] = False
    frame[:, 12] = True
    assert len(merge(frame)) == 5 and len(merge(np.ones((40, 50), bool))) == 1


def test_a_plan_has_the_drone_of_the_six_rooms_and_is_kept_as_it_is(scene):
    plan = scene_of(PLAN, like=scene.vehicle)
    Path("scene.xml").write_text(plan.text)
    kept = pecjax.load_scene("scene.xml", like=scene.vehicle)
    assert kept.text == plan.text and plan.notices == kept.notices == ()
    for name in ("lower", "upper", "bounds", "starts", "goals", "names"):
        np.testing.assert_array_equal(getattr(kept.map, name), getattr(plan.map, name))


def test_a_plan_may_come_from_any_editor():
    scene, text = scene_of(PLAN), PLAN.replace("\n", "\r\n").replace("..", "  ")
    Path("plan.txt").write_bytes(b"\xef\xbb\xbf" + text.encode())
    np.testing.assert_array_equal(pecjax.load_scene("plan.txt").wall_lower, scene.wall_lower)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "plan.txt: no wall; draw one with #"),
        ("...\n. S", "plan.txt: no wall"),
        (
            "###\n#x#\n",
            "plan.txt, line 2, column 2: 'x' is no part of a plan; # is wall, . is free, S a start",
        ),
        ("###\n\t#\n", "plan.txt, line 2, column 1: '\\t' is no part"),
        ("cell 0\n###", "plan.txt, line 1: cell is 0; give metres above 0, 100 at most"),
        ("height nan\n###", "plan.txt, line 1: height is nan"),
        ("cell x\n###", "cell is x"),
        ("cell 101\n###", "cell is 101"),
        ("###\ncell 1\n", "plan.txt, line 2: 'cell' stands below; write it above the drawing"),
        ("###\n#S#\n###", "plan.txt: marks starts and no goal; mark both, or neither"),
        ("#." * 1500, "its walls take more than 1,000 boxes"),
        ("#" * 2000 + "\n" * 1000 + "#", "2000 by 1001 characters"),
        ("cell 100\n" + "#" * 30, "reaches beyond 1,000 m"),
        ("#" * 2**20 + "#", "is larger than"),
    ],
)
def test_a_plan_that_cannot_be_read_says_where(text, words):
    with pytest.raises(pecjax.InputError) as caught:
        scene_of(text)
    assert words in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_a_plan_that_is_no_text_or_not_there():
    Path("plan.txt").write_bytes(b"\xff\xfe\x00")
    for name, words in (("plan.txt", "cannot be read as text"), ("nowhere.txt", "no such scene file")):
        with pytest.raises(pecjax.InputError, match=words):
            pecjax.load_scene(name)


@given(st.text("#.SG /cel:0.5\n\tx", max_size=60))
@with_settings(deadline=None, max_examples=200)
def test_any_text_is_read_or_refused(text):
    try:
        read_text_plan(Path("plan.txt"), text)
    except pecjax.InputError as error:
        assert "\n" not in str(error)


# Walls alone.

WALLS = """<mujoco>{}<worldbody><geom type="plane" size="0 0 1"/>
<geom type="box" size="5 0.1 1" pos="0 -4 1"/><geom type="box" size="5 0.1 1" pos="0 4 1"/>{}</worldbody>
</mujoco>"""
# What would change the drone if it were not kept apart from the map.
DEFAULTS = """<compiler angle="degree"/><default><geom contype="2" density="9" mass="3" group="4"/>
<joint damping="3" armature="1" stiffness="2"/><site type="box" pos="1 1 1"/><camera fovy="12" pos="0 0 9"/>
<general ctrlrange="-1 1" gear="2"/><default class="rotor"><geom rgba="1 0 0 1"/></default></default>"""


@pytest.mark.parametrize("head", ["", DEFAULTS, '<option timestep="0.02" integrator="RK4"/>'])
def test_walls_alone_get_the_drone_of_the_six_rooms(head, scene):
    walls = scene_of(
        WALLS.format(head, '<geom name="default" type="box" size="1 1 1"/>'), "map.xml", like=scene.vehicle
    )
    assert walls.notices == ("there is no body named 'drone'; the drone of the six rooms is added",)
    assert len(walls.map.names) == 4 and "default" in walls.map.names
    kept = scene_of(walls.text, "scene.xml", like=scene.vehicle)
    assert kept.text == walls.text and kept.notices == ()


def test_walls_alone_may_choose_timestep_and_range_of_depth():
    more = '<option timestep="0.01"/><custom><numeric name="depth_range" data="0.3 7"/></custom>'
    vehicle = scene_of(WALLS.format(more, ""), "map.xml").vehicle
    assert (vehicle.timestep, vehicle.camera.near, vehicle.camera.far) == (0.01, 0.3, 7)


@pytest.mark.parametrize(
    "moving",
    [
        '<body name="bird" pos="0 0 1"><freejoint/><geom size="0.1"/></body>',
        '<body name="door"><joint/><geom size="0.1"/></body>',
    ],
)
def test_a_drone_under_another_name_is_not_taken_for_a_wall(moving):
    with pytest.raises(
        pecjax.InputError, match=r"no body named 'drone', and something moves; give the drone's"
    ):
        scene_of(WALLS.format("", moving), "map.xml")


def test_maps_with_a_drone_keep_their_own():
    assert read_map_file(write("map.xml", OTHER_MAP)).notices == ()
    assert pecjax.load_scene("map.xml").drone_radius == 0.18


def write(name, text):
    Path(name).write_text(text)
    return Path(name)


# Starts and goals.

MARKS = """<site name="start" pos="-3 1 0"/><site name="goal_a" pos="3 1 0"/>
<body pos="1 0 0"><site name="goal_b" pos="1 2 0"/></body>"""


def flown(*maps, **settings):
    return Rooms(maps=maps, **settings).configurations()


def test_every_start_is_flown_to_every_goal_of_its_map():
    write("map.xml", WALLS.format("", MARKS))
    write("plan.txt", PLAN)
    write("bare.xml", WALLS.format("", ""))
    table = flown("map.xml", "bare.xml", "plan.txt")
    np.testing.assert_array_equal(table.map_id, [0, 0, 2, 2])
    np.testing.assert_allclose(table.start, [(-3, 1), (-3, 1), (0.6, 1.4), (0.6, 1.4)], rtol=1e-6)
    np.testing.assert_allclose(
        sorted(table.goal.tolist()), [(1.4, 0.6), (1.8, 1.4), (2, 2), (3, 1)], rtol=1e-6
    )
    write("pairs.csv", "0 0 1 1\n")
    assert flown("map.xml", table="pairs.csv").size == 1


def test_without_marks_the_papers_configurations_are_flown_and_said_to_be():
    write("bare.xml", WALLS.format("", ""))
    jax.tree.map(np.testing.assert_array_equal, flown("bare.xml"), pecjax.COORDINATE_SET_1)
    jax.tree.map(np.testing.assert_array_equal, flown(), pecjax.COORDINATE_SET_1)
    for table in (None, "1", "2"):
        with pytest.raises(pecjax.InputError, match=r"these are the paper's configurations; give your own"):
            Rooms(maps=("bare.xml",), table=table).make()
    write("pairs.csv", "0 0 9 9\n")
    for more in ({"maps": ("bare.xml",), "table": "pairs.csv"}, {"table": "pairs.csv"}):
        with pytest.raises(pecjax.InputError, match="outside the map") as caught:
            Rooms(**more).make()
        assert "the paper's" not in str(caught.value)


def test_a_table_is_known_by_its_name_or_its_map():
    names = [Rooms(**given).table_name for given in ({}, {"table": "2"}, {"maps": ("a.txt", "b.txt")})]
    assert names == ["1", "2", "a.txt"]


# What check prints.


def test_check_draws_what_it_understood_with_characters(capsys):
    write("plan.txt", "cell 1\n" + DRAWN)
    assert main(["check", "--scene", "plan.txt"]) == 0
    *_, legend = lines = capsys.readouterr().out.splitlines()
    drawn = lines[lines.index("") + 1 : -1]
    assert legend.startswith("# wall at 1.2 m, S start, G goal, * both; ")
    width, height = map(float, re.search(r"; (\S+) by (\S+) m each", legend).groups())
    assert 2 * len(drawn[0]) / 36 > 1 and height == pytest.approx(2 * width, rel=0.1)
    expected = DRAWN.splitlines()
    for row, line in enumerate(drawn):
        for column, character in enumerate(line):
            # The one character of the plan that this one lies in.
            y, x = (row + 0.5) * len(expected) / len(drawn), (column + 0.5) * len(expected[0]) / len(line)
            if abs(x % 1 - 0.5) < 0.3 and abs(y % 1 - 0.5) < 0.3:
                there = expected[int(y)][int(x)]
                assert (character == "#") == (there == "#"), (row, column)
    text = "".join(drawn)
    assert (text.count("S"), text.count("G")) == (2, 1)


DRAWN = """\
############
#..........#
#.S..##..G.#
#....##....#
#..........#
#.S........#
############
"""


def test_check_lists_few_walls_and_leaves_out_what_is_flown_over(capsys):
    low = '<geom name="table" type="box" size="0.5 0.5 0.3" pos="0 0 0.3"/>'
    sides = "".join(f'<geom type="box" size="0.1 4 1" pos="{x} 0 1"/>' for x in (-5, 5))
    write("map.xml", WALLS.format("", low + sides + MARKS))
    assert main(["check", "--scene", "map.xml"]) == 0
    out, err = capsys.readouterr()
    assert re.search(r"^  table +x -0.5 to 0.5 +y -0.5 to 0.5 +z 0 to 0.6 *$", out, re.M)
    assert re.search(r"^  geom 0 +x without end to without end .* z without end to 0 *$", out, re.M)
    inside = [line[2:-2] for line in out.splitlines() if line.startswith("#") and "wall" not in line][2:-2]
    assert inside and not any("#" in line for line in inside)
    assert err.count("notice") == 1


def test_check_approximates_when_it_is_asked_to(capsys):
    write("map.xml", WALLS.format("", MARKS + '<geom name="post" type="cylinder" size="0.3 1" pos="0 0 1"/>'))
    assert main(["check", "--scene", "map.xml"]) == 2
    assert (
        "geom 'post' collides and is a cylinder; only boxes and planes can be walls: give --task.approximate"
        in (capsys.readouterr().err)
    )
    assert main(["check", "--scene", "map.xml", "--task.approximate", "0.1"]) == 0
    assert "boxes along the axes stand for geom 'post'; they hold all of it" in capsys.readouterr().err


# The page.


def blocks(language=""):
    found = re.findall(r"^```(\w*)\n(.*?)^```$", DOCS, re.M | re.S)
    return [block for written, block in found if written == language]


def test_the_commands_of_the_page_run(capsys):
    write("my_plan.txt", blocks("text")[0])
    write("my_walls.xml", blocks("xml")[0])
    written = {"my_plan.txt", "my_walls.xml"}
    commands = [line.split()[1:] for block in blocks() for line in block.splitlines()]
    ran = [words for words in commands if words and words[0] in ("new-map", "check")]
    assert len(ran) >= 4
    for words in ran:
        assert main(words) == 0, (words, capsys.readouterr().err)
    written |= {words[1] for words in ran if words[0] == "new-map"}
    trained = [words for words in commands if words[:2] == ["train", "--scene"]]
    assert trained and all(words[2] in written for words in trained)
