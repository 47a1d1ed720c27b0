"""Files from anyone: refused in one line or bounded, never obeyed."""

import time
from pathlib import Path

import fuzz
import pytest

import pecjax
from pecjax.world import load_scene

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
    assert len(load_scene(path).wall_names) == 15
    (tmp_path / "more.xml").write_text('<mujocoinclude><size memory="900G"/></mujocoinclude>')
    with pytest.raises(pecjax.InputError, match="memory"):
        load_scene(path)
    (tmp_path / "more.xml").unlink()
    with pytest.raises(pecjax.InputError, match=r"includes .*more\.xml: not XML"):
        load_scene(path)


def test_a_map_that_includes_itself(edited_rooms, tmp_path):
    path = tmp_path / "map.xml"
    path.write_text(edited_rooms(("<worldbody>", '<include file="map.xml"/><worldbody>')).read_text())
    with pytest.raises(pecjax.InputError):
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
    begun = time.monotonic()
    with pytest.raises(pecjax.InputError, match=words):
        load_scene(edited_rooms(replacement))
    assert time.monotonic() - begun < 20


def test_a_map_too_large_to_look_for_paths_on(edited_rooms, tmp_path):
    far = edited_rooms(("<worldbody>", '<worldbody><geom type="box" size="1 1 1" pos="900 900 1"/>'))
    scene = load_scene(far)
    with pytest.raises(pecjax.InputError, match="is the most that paths are looked for on"):
        pecjax.world.coordinates.check_coordinates(scene, pecjax.COORDINATE_SET_1, flight_height=1.2)


def test_a_control_period_of_a_hundred_million_steps(edited_rooms):
    scene = load_scene(edited_rooms(('timestep="0.02"', 'timestep="1e-9"')))
    with pytest.raises(pecjax.InputError, match="timestep"):
        pecjax.RoomsNavigation(scene)


def test_some_hundreds_of_broken_files(tmp_path: Path):
    found = fuzz.fuzz(320, seed=7, run=fuzz.sample_run(tmp_path / "run"))
    assert found.total() == 320
    kinds = {"scene", "coordinates", "run", "checkpoint"}
    assert {kind for kind, fate in found if fate == "refused"} == kinds
    assert {kind for kind, fate in found if fate == "read"} == kinds
