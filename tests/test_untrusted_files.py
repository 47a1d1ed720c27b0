"""Files from anyone: refused in one line or bounded, never obeyed."""

import functools
import json
import time
import tracemalloc
import zipfile
from pathlib import Path

import fuzz
import jax
import mujoco
import numpy as np
import pytest

import pecjax
from pecjax import settings_tree
from pecjax.cli import main
from pecjax.envs.rooms import load_scene
from pecjax.runtime import devices
from pecjax.storage.arrays import CorruptFileError, read_arrays, write_arrays
from pecjax.training.build import build
from pecjax.training.presets import PRESETS
from pecjax.training.program import several_runs
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import configuration_table, trajectory_table

BOMB = """<!DOCTYPE lolz [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;"><!ENTITY d "&c;&c;&c;&c;&c;&c;&c;&c;&c;&c;">]>
<mujoco><custom><text name="t" data="&d;"/></custom></mujoco>"""
STEALING = '<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/passwd">]><mujoco><custom>&x;</custom></mujoco>'


@pytest.mark.parametrize("text", [BOMB, STEALING])
def test_entities_are_refused(text, tmp_path):
    (tmp_path / "map.xml").write_text(text)
    with pytest.raises(pecjax.InputError, match="declares a document type or entities"):
        load_scene(tmp_path / "map.xml")


@pytest.mark.parametrize(
    "piece",
    [
        '<include file="../secret.xml"/>',
        '<include file="/etc/passwd"/>',
        '<include file="inner/../../secret.xml"/>',
        '<include file="link.xml"/>',
        '<asset><mesh name="m" file="../secret.obj"/></asset>',
        '<compiler meshdir=".."/>',
        '<asset><texture name="t" type="cube" fileright="../secret.png"/></asset>',
    ],
)
def test_nothing_outside_the_maps_folder_is_read(piece, edited_rooms, tmp_path):
    (tmp_path / "secret.xml").write_text("<mujocoinclude/>")
    home = tmp_path / "home"
    home.mkdir()
    (home / "inner").mkdir()
    (home / "link.xml").symlink_to(tmp_path / "secret.xml")
    path = home / "map.xml"
    path.write_text(edited_rooms(("<worldbody>", f"{piece}<worldbody>")).read_text())
    with pytest.raises(pecjax.InputError, match="outside the map's folder"):
        load_scene(path)


def test_includes_inside_the_folder_are_followed_and_looked_through(edited_rooms, tmp_path):
    path = tmp_path / "map.xml"
    path.write_text(edited_rooms(("<worldbody>", '<include file="more.xml"/><worldbody>')).read_text())
    wall = '<geom type="box" size="0.1 1 1" pos="-6 6 1"/>'
    (tmp_path / "more.xml").write_text(f"<mujocoinclude><worldbody>{wall}</worldbody></mujocoinclude>")
    assert len(load_scene(path).map.names) == 15
    (tmp_path / "more.xml").write_text('<mujocoinclude><size memory="900G"/></mujocoinclude>')
    with pytest.raises(pecjax.InputError, match="memory"):
        load_scene(path)
    (tmp_path / "more.xml").unlink()
    with pytest.raises(pecjax.InputError, match=r"includes .*more\.xml: not XML"):
        load_scene(path)


@pytest.mark.parametrize(
    "piece",
    [
        '<asset><model name="m" file="sub.xml"/></asset><worldbody>',
        '<worldbody><attach model="m" body="b" prefix="p"/>',
        '<worldbody><attach body="drone" prefix="p"/>',  # of the map itself, and so once more within it
        '<worldbody><body><composite type="cable" count="4096 4096 4096" size="1"/></body>',
        '<worldbody><flexcomp name="f" type="grid" count="4096 4096 4096" dim="3"/>',
        '<deformable><flex name="f" dim="1"/></deformable><worldbody>',
        '<extension><plugin plugin="mujoco.sdf.bolt"/></extension><worldbody>',
        '<compiler><lengthrange mode="all" inttotal="1e9"/></compiler><worldbody>',
        '<sensor><rangefinder camera="depth"/></sensor><worldbody>',
        '<sensor><tactile geom="g" mesh="m"/></sensor><worldbody>',
    ],
)
def test_what_makes_much_of_little_is_refused_before_mujoco_reads_it(
    piece, edited_rooms, tmp_path, monkeypatch
):
    path = tmp_path / "map.xml"
    path.write_text(edited_rooms(("<worldbody>", piece)).read_text())
    (tmp_path / "sub.xml").write_text('<mujoco><include file="../secret.xml"/></mujoco>')
    monkeypatch.setattr(mujoco.MjSpec, "from_file", None)
    with pytest.raises(pecjax.InputError, match=r"map\.xml, line \d+: <\w+.*> is not read; \w+"):
        load_scene(path)


def assets(count, piece):
    return "<asset>" + "".join(piece.format(number) for number in range(count)) + "</asset><worldbody>"


@pytest.mark.parametrize(
    ("piece", "words"),
    [
        (
            '<worldbody><replicate count="400"><replicate count="400" offset="1 0 0"><geom size="1"/>'
            "</replicate></replicate>",
            "line 31: here the map exceeds 10,000 elements",
        ),
        (
            '<worldbody><replicate count="400"><include file="sub.xml"/></replicate>',
            r"sub\.xml, line 1: here the map exceeds 10,000 elements",
        ),
        (
            '<worldbody><replicate count="100"><body><replicate count="50"><body/></replicate></body>'
            "</replicate>",
            "4,096 bodies",
        ),
        (
            assets(20, '<texture name="t{}" builtin="flat" width="4096" height="4096"/>'),
            "would take 6,040 MB",
        ),
        (
            '<default><texture width="4096" height="4096"/></default>'
            + assets(20, '<texture name="t{}" builtin="flat"/>'),
            "would take 6,040 MB",
        ),
        (
            assets(9, '<hfield name="h{}" nrow="4096" ncol="4096" size="1 1 1 1"/>'),
            "would take 604 MB",
        ),
        (
            '<asset><mesh name="m" builtin="plate" params="1000 1000"/></asset><worldbody>',
            "would take 4,096 MB",
        ),
        ('<size nuser_geom="4096"/><worldbody>', "256 is the most"),
        ('<worldbody><replicate count="0x7fffffff"/>', "no number"),
        ('<worldbody><replicate count="nan"/>', "no number"),
    ],
)
def test_amounts_are_added_up_before_mujoco_reads_the_map(piece, words, edited_rooms, tmp_path, monkeypatch):
    path = tmp_path / "map.xml"
    path.write_text(edited_rooms(("<worldbody>", piece)).read_text())
    wall = '<replicate count="400" offset="1 0 0"><geom size="1"/></replicate>'
    (tmp_path / "sub.xml").write_text(f"<mujocoinclude>{wall}</mujocoinclude>")
    monkeypatch.setattr(mujoco.MjSpec, "from_file", None)
    with pytest.raises(pecjax.InputError, match=words):
        load_scene(path)


def test_what_a_map_may_need_is_within_the_bounds(edited_rooms):
    """Generated textures and walls, as MuJoCo's own examples have them."""
    texture = '<texture name="t" type="2d" builtin="checker" width="512" height="512"/>'
    sky = '<texture type="skybox" builtin="gradient" width="512" height="3072"/>'
    walls = (
        '<replicate count="20" offset="0 0.8 0"><geom type="box" size="0.1 0.1 1" pos="-9 -8 1"/></replicate>'
    )
    piece = f"<asset>{texture}{sky}</asset><worldbody>{walls}"
    assert len(load_scene(edited_rooms(("<worldbody>", piece))).map.names) == 34


def test_a_map_that_is_a_link_includes_what_lies_beside_the_link(edited_rooms, tmp_path):
    """As MuJoCo does; what lies beside the linked file is another folder's."""
    (tmp_path / "home").mkdir()
    text = edited_rooms(("<worldbody>", '<include file="more.xml"/><worldbody>')).read_text()
    (tmp_path / "map.xml").write_text(text)
    (tmp_path / "more.xml").write_text("<mujocoinclude/>")
    (tmp_path / "home" / "map.xml").symlink_to(tmp_path / "map.xml")
    (tmp_path / "home" / "more.xml").write_text('<mujocoinclude><size memory="900G"/></mujocoinclude>')
    with pytest.raises(pecjax.InputError, match="memory"):
        load_scene(tmp_path / "home" / "map.xml")


def test_a_map_that_includes_itself(edited_rooms, tmp_path):
    path = tmp_path / "map.xml"
    path.write_text(edited_rooms(("<worldbody>", '<include file="map.xml"/><worldbody>')).read_text())
    with pytest.raises(pecjax.InputError, match="include"):
        load_scene(path)


@pytest.mark.parametrize(
    ("replacement", "words"),
    [
        (("<worldbody>", '<size memory="900G"/><worldbody>'), "memory"),
        (("<worldbody>", '<size nuserdata="2000000000"/><worldbody>'), "nuserdata"),
        (
            (
                "<worldbody>",
                '<asset><hfield name="h" nrow="90000" ncol="9" size="1 1 1 1"/></asset><worldbody>',
            ),
            "nrow",
        ),
        (
            (
                "<worldbody>",
                '<worldbody><replicate count="9999999" offset="1 0 0"><geom size="1"/></replicate>',
            ),
            "count",
        ),
        (('resolution="16 12"', 'resolution="90000 90000"'), "resolution"),
        (("<worldbody>", "<worldbody>" + "<!-- x -->" * 200_000), "larger than"),
        (("<worldbody>", "<worldbody>" + '<site size="1"/>' * 21_000), "elements"),
        (("<worldbody>", '<worldbody><geom type="box" size="1 1 1" pos="nan 0 0"/>'), "geom_pos|compile"),
        (('timestep="0.02"', 'timestep="nan"'), "timestep"),
        (('timestep="0.02"', 'timestep="0.02" wind="0 1e300 0"'), "wind"),
    ],
)
def test_absurd_amounts_are_refused_at_once(replacement, words, edited_rooms):
    started = time.process_time()
    with pytest.raises(pecjax.InputError, match=words):
        load_scene(edited_rooms(replacement))
    assert time.process_time() - started < 20


def test_a_map_too_large_to_look_for_paths_on(edited_rooms, tmp_path):
    far = edited_rooms(("<worldbody>", '<worldbody><geom type="box" size="1 1 1" pos="900 900 1"/>'))
    scene = load_scene(far)
    with pytest.raises(pecjax.InputError, match="is the most that paths are looked for on"):
        pecjax.check_coordinates(scene, pecjax.COORDINATE_SET_1, flight_height=1.2)


def test_a_control_period_of_a_hundred_million_steps(edited_rooms):
    scene = load_scene(edited_rooms(('timestep="0.02"', 'timestep="1e-9"')))
    with pytest.raises(pecjax.InputError, match="timestep"):
        pecjax.RoomsNavigation(scene)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("task.resolution", [40000, 40000], "resolution is 40000×40000; 1 to 1,048,576 pixels"),
        ("task.resolution", [0, 5], "resolution is 0×5"),
        ("task.resolution", [10**12, 1], "resolution is 1000000000000"),
        ("agent.num_envs", 2**30, "num-envs is 1073741824; 1,048,576 is the most"),
        ("agent.num_steps", 10**15, "num-steps is 1000000000000000"),
        ("agent.num_steps", 2**20, "more than 268,435,456 steps an iteration"),
        ("agent.network.hidden", [64, 10**6], "hidden is 1000000; 16,384 is the most"),
        ("agent.network.hidden", [64, -1], "at least 1 wide"),
        ("agent.network.hidden", [64] * 1000, "1000 layers"),
        ("apex.network.head", 10**6, "head is 1000000"),
        ("apex.network.head", 0, "head is 0 wide; give at least 1"),
        ("apex.replay.beta", -1.0, "beta is -1; give 0 or more"),
        ("task.max_steps", 0, "max-steps is 0; give 1 or more"),
        ("task.goal_radius", 0.0, "goal-radius is 0; give more than 0"),
        ("task.gains.max_tilt", 100.0, "max-tilt is 100; give more than 0, at most 1.5"),
        ("apex.replay.capacity", 2**40, "capacity is 1099511627776"),
        ("apex.batch_size", 2**40, "batch-size is 1099511627776"),
        ("apex.target_period", 2**31, "target-period is 2147483648"),
        ("apex.replay_ratio", float("inf"), "replay-ratio is inf; it must be finite"),
        ("evaluation.episodes", 10**6, "episodes is 1000000; 100,000 is the most"),
        ("stop.iterations", 10**20, "iterations is 100000000000000000000; 2,147,483,647 is the most"),
        ("configurations_every", 0, "configurations-every is 0"),
        ("task.max_steps", 10**9, "max-steps is 1000000000; 1,000,000 is the most"),
        ("task.control_period", float("nan"), "control-period is nan; it must be finite"),
        ("task.gains.height", float("inf"), "height is inf; it must be finite"),
        ("sampler.alpha", -1, "alpha is -1"),
        ("evaluation.seed", -1, "seed is -1"),
    ],
)
def test_absurd_settings_of_a_strangers_run_are_refused(path, value, words, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(devices, "use_all_cores", lambda: None)
    monkeypatch.setattr(devices, "keep_compiled_programs", lambda *_: None)
    run = fuzz.sample_run(tmp_path / "run")
    config = json.loads((run / "config.json").read_text())
    if path.startswith("apex."):
        config["settings"] |= settings_tree.to_json(PRESETS["apex-fast"])
        path = path.replace("apex", "agent")
    *parents, name = ("settings." + path).split(".")
    functools.reduce(dict.__getitem__, parents, config)[name] = value
    (run / "config.json").write_text(json.dumps(config))
    for file, content in PRESETS["fast"].task.files().items():  # a sampler is made over its configurations
        (run / file).write_bytes(content)
    for command in (["eval", run], ["train", "--resume", "--out", run]):
        if name == "episodes" and command[0] == "eval":
            command += ["--episodes", value]
        assert main([str(word) for word in command]) == 2
        out, err = capsys.readouterr()
        assert words in err and err.count("\n") == 1 and out == ""


def test_images_that_no_memory_holds_are_refused():
    """Each number may be had, and all of them together may not."""
    many = settings_tree.set_path(PRESETS["fast"], "task.resolution", (1024, 1024))
    many = settings_tree.set_path(many, "agent.num_envs", 2**17)
    with pytest.raises(pecjax.InputError, match=r"the observations of an iteration take 26388\.4 GB"):
        build(many, 1)
    runs = settings_tree.set_path(PRESETS["fast"], "agent.num_envs", 2**20)
    with pytest.raises(pecjax.InputError, match=r"the observations of an iteration of 64 runs at once take"):
        several_runs(runs, *runs.task.make(), 64)


WANTED = {"w": np.ones((3, 2), np.float32)}
LARGE = np.zeros(2**23)  # 64 MB


@pytest.mark.parametrize(
    ("save", "arrays", "error", "words"),
    [
        (np.savez_compressed, {"['w']": LARGE}, CorruptFileError, "'\\['w'\\].npy' is no plain array"),
        (np.savez, {"['w']": LARGE}, pecjax.InputError, "differs in \\['w'\\]"),
        (np.savez, {"['w']": WANTED["w"], "more": LARGE}, pecjax.InputError, "differs in more"),
        (np.savez, {"['w']": WANTED["w"], "about": LARGE}, CorruptFileError, "is no text"),
        (np.savez, {"['w']": np.array([{}])}, CorruptFileError, "is no array of"),
        (np.savez, {}, pecjax.InputError, "differs in \\['w'\\]"),
    ],
)
def test_arrays_are_read_only_once_their_headers_are_as_wanted(save, arrays, error, words, tmp_path):
    save(tmp_path / "1.npz", **arrays)
    tracemalloc.start()
    try:
        with pytest.raises(error, match=words):
            read_arrays(tmp_path / "1.npz", WANTED)
        assert tracemalloc.get_traced_memory()[1] < 2**23
    finally:
        tracemalloc.stop()


def test_a_header_that_promises_more_than_the_file_holds(tmp_path):
    path = tmp_path / "1.npz"
    write_arrays(path, WANTED)
    with zipfile.ZipFile(path, "w") as file:
        text = "{'descr': '<f4', 'fortran_order': False, 'shape': (999999999, 99), }".ljust(117) + "\n"
        file.writestr("['w'].npy", b"\x93NUMPY\x01\x00\x76\x00" + text.encode() + b"\0" * 24)
    with pytest.raises(CorruptFileError, match="is no array of"):
        read_arrays(path, {"w": jax.ShapeDtypeStruct((999999999, 99), np.float32)})


def test_a_changed_header_makes_a_file_corrupt_and_not_anothers(tmp_path):
    """So that a training falls back to the checkpoint before."""
    path = tmp_path / "1.npz"
    write_arrays(path, WANTED, {"seed": 1})
    content = path.read_bytes()
    for old, new in ((b"(3, 2)", b"(2, 3)"), (b'"seed": 1', b'"seed": 2')):
        path.write_bytes(content.replace(old, new))
        with pytest.raises(CorruptFileError):
            read_arrays(path, WANTED, {"seed": 1})
    path.write_bytes(content)
    np.testing.assert_array_equal(read_arrays(path, WANTED, {"seed": 1})["w"], WANTED["w"])


KEPT = {
    "configurations": {name: np.arange(3) for name in ("trials", "failures", "probability")},
    "episodes": {
        "config_id": np.arange(3), "success": np.ones(3, bool), "return": np.zeros(3),
        "length": np.array([2, 0, 1]), "recorded": np.arange(2), "poses": np.zeros((2, 3, 7)),
    },
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("configurations", {"trials": None}),
        ("configurations", {"failures": np.zeros(4)}),
        ("configurations", {"probability": np.zeros((3, 3))}),
        ("configurations", {"trials": np.zeros(())}),
        ("configurations", {"trials": np.array(["one", "two", "three"])}),
        ("configurations", {"failures": np.full(3, np.nan)}),
        ("episodes", {"length": None}),
        ("episodes", {"poses": None}),
        ("episodes", {"length": np.array([2, 5, 1])}),
        ("episodes", {"length": np.array([2, 10**18, 1])}),
        ("episodes", {"recorded": np.array([1, 7])}),
        ("episodes", {"recorded": np.array([0.5, 1])}),
        ("episodes", {"recorded": np.zeros(0, int), "poses": np.zeros((0, 3, 7))}),
        ("episodes", {"poses": np.zeros((2, 3))}),
        ("episodes", {"poses": np.zeros(())}),
        ("episodes", {"success": np.array(["no", "no", "no"])}),
    ],
)
def test_arrays_of_another_kind_are_no_tables(name, changed, tmp_path):
    directory = RunDirectory(tmp_path)
    make = configuration_table if name == "configurations" else trajectory_table
    directory.write_arrays(name, 4, KEPT[name])
    assert len(make(directory)) == (3 if name == "configurations" else 4)
    arrays = KEPT[name] | changed
    directory.write_arrays(name, 4, {part: array for part, array in arrays.items() if array is not None})
    with pytest.raises(pecjax.InputError, match=rf"{name}.*; train") as error:
        make(directory)
    assert "\n" not in str(error.value) and len(str(error.value)) < 500


@pytest.mark.slow
def test_some_hundreds_of_broken_files(tmp_path: Path):
    found = fuzz.fuzz(320, seed=7, run=fuzz.sample_run(tmp_path / "run"))
    assert found.total() == 320
    kinds = {"scene", "coordinates", "run", "checkpoint"}
    assert {kind for kind, fate in found if fate == "refused"} == kinds
    assert {kind for kind, fate in found if fate == "read"} == kinds
