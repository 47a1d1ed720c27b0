"""Other shapes as boxes: all that C MuJoCo calls solid is held, and little beyond it."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import pecjax
from pecjax.envs.rooms.box_cover import cover
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.depth import raycast
from pecjax.envs.rooms.mjcf_file import read_map_file

ROOT = Path(__file__).parents[1]
REACH = 0.12  # m
FLOAT32 = 1e-4  # m, what single precision and MuJoCo's own distances are off by
PROBE = 1e-3  # m, radius of the sphere that MuJoCo measures distances from
# A cube without its corners, in a file.
MESH = "".join(
    f"v {' '.join(map(str, np.roll((0.3 * x, 0.3 * y, 0.1 * z), turn)))}\n"
    for turn in range(3)
    for x in (-1, 1)
    for y in (-1, 1)
    for z in (-1, 1)
) + "".join(f"f {a} {b} {c}\n" for a, b, c in [(1, 2, 3), (2, 3, 4), (5, 6, 7), (9, 10, 11), (17, 18, 19)])
SHAPES = {
    "turned": 'type="box" size="1 0.1 0.8" euler="0 0 33" pos="-2.5 -2 0.8"',
    "tilted": 'type="box" size="0.3 0.2 0.25" euler="20 30 40" pos="2 -2 1"',
    "pillar": 'type="cylinder" size="0.3 1" pos="0 2 1"',
    "log": 'type="cylinder" size="0.2 0.4" euler="70 0 25" pos="2.4 2 1.4"',
    "ball": 'type="sphere" size="0.25" pos="-1.5 1.8 1.2"',
    "pill": 'type="capsule" size="0.15 0.3" euler="30 50 0" pos="0 -2.2 1.3"',
    "egg": 'type="ellipsoid" size="0.35 0.2 0.15" euler="10 20 70" pos="-3 1 1.6"',
    "mesh": 'type="mesh" mesh="stone" euler="15 25 35" pos="3.4 0.4 0.6"',
}


def world(shapes, extra=""):
    geoms = "".join(f'<geom name="{name}" {about}/>' for name, about in shapes.items())
    asset = '<asset><mesh name="stone" file="stone.obj"/></asset>' if "mesh" in shapes else ""
    return f"""<mujoco><compiler angle="degree"/>{asset}<worldbody>
      <geom name="floor" type="plane" size="0 0 1"/>
      <geom name="south" type="box" size="5 0.1 1.25" pos="0 -4 1.25"/>
      <geom name="north" type="box" size="5 0.1 1.25" pos="0 4 1.25"/>
      <body pos="0.1 0.2 0" euler="0 0 10"><geom name="far" type="box" size="0.4 0.1 0.3" euler="0 0 -10"/>
      <body euler="5 0 0">{geoms}</body></body>{extra}</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shapes")
    (folder / "stone.obj").write_text(MESH)
    (folder / "map.xml").write_text(world(SHAPES))
    return folder


@pytest.fixture(scope="module")
def approximated(folder):
    return pecjax.load_scene(folder / "map.xml", approximate=REACH)


@pytest.fixture(scope="module")
def true_distance(folder):
    """(N, 3) m -> (N,) m to the nearest geom, by C MuJoCo in the map as it was written."""
    probe = f'<body name="probe" mocap="true"><geom name="probe" size="{PROBE}"/></body>'
    (folder / "probed.xml").write_text(world(SHAPES, probe))
    model = mujoco.MjModel.from_xml_path(str(folder / "probed.xml"))
    data = mujoco.MjData(model)
    probed = model.geom("probe").id

    def measure(points):
        found = []
        for point in points:
            data.mocap_pos[0] = point
            mujoco.mj_forward(model, data)
            to_geoms = [
                mujoco.mj_geomDistance(model, data, probed, geom, 20.0, None)
                for geom in range(model.ngeom)
                if geom != probed
            ]
            found.append(min(to_geoms) + PROBE)
        return np.array(found)

    return measure


def said(scene):
    """The reach (m) that the notice says."""
    return float(re.search(r"reach at most (\S+) m beyond", scene.notices[-1])[1])


def test_clearance_is_mujocos_less_the_reach_at_most(approximated, true_distance):
    draw = np.random.default_rng(0)
    anywhere = draw.uniform((-4, -3.5, 0.05), (4, 3.5, 2.2), (400, 3))
    low, high = approximated.wall_lower, approximated.wall_upper
    boxes = draw.integers(3, len(low), 800)  # the first three are floor and outer walls
    in_boxes = draw.uniform(low[boxes], high[boxes])
    points = np.concatenate([anywhere, in_boxes])
    true = true_distance(points)
    ours = np.asarray(jax.jit(wall_distance)(approximated.walls, jnp.asarray(points, jnp.float32)))
    reach = said(approximated)
    assert reach <= REACH
    assert np.all(ours <= np.maximum(true, 0) + FLOAT32)
    assert np.all(ours >= true - reach - FLOAT32)
    # Many points lay in shapes, and many in boxes beyond them.
    assert (true < 0).sum() > 100 and ((true > 0.01) & (ours == 0)).sum() > 50


def test_rays_end_no_later_than_mujocos_and_near_something_solid(folder, approximated, true_distance):
    model = mujoco.MjModel.from_xml_path(str(folder / "map.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    draw = np.random.default_rng(1)
    reach, cast = said(approximated), jax.jit(raycast)
    hits, errors = [], []
    for _ in range(25):
        origin = draw.uniform((-3.5, -3, 0.3), (3.5, 3, 2))
        if true_distance(origin[None])[0] < reach + 0.01:
            continue
        ways = draw.normal(size=(60, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        true = np.array([
            mujoco.mj_ray(model, data, origin, way, None, 1, -1, np.zeros(1, np.int32)) for way in ways
        ])  # fmt: skip
        true = np.where(true < 0, np.inf, true)
        ours = np.asarray(cast(approximated.walls, jnp.float32(origin), jnp.float32(ways.T)))
        assert np.all(ours <= true + FLOAT32)
        met = ours < 20
        hits.append(origin + ours[met, None] * ways[met])
        errors.append(true[met] - ours[met])
    hits, errors = np.concatenate(hits), np.concatenate(errors)
    assert np.all(true_distance(hits) <= reach + 3e-4)
    assert len(hits) > 500 and (errors > 0.005).sum() > 50 and np.median(errors) < reach


def test_the_kept_map_has_the_boxes_and_asks_for_nothing(folder, approximated, tmp_path):
    assert "stone" not in approximated.text
    assert {"floor", "south", "north", "far"} < set(approximated.map.names)
    assert len(approximated.map.names) > 40
    (tmp_path / "scene.xml").write_text(approximated.text)
    for approximate in (None, REACH):
        kept = pecjax.load_scene(tmp_path / "scene.xml", approximate=approximate)
        assert kept.text == approximated.text and kept.notices == ()
        np.testing.assert_array_equal(kept.wall_lower, approximated.wall_lower)
        np.testing.assert_array_equal(kept.wall_upper, approximated.wall_upper)


def test_one_notice_says_what_became_boxes(approximated):
    drone, boxes = approximated.notices
    assert "there is no body named 'drone'" in drone
    number = len(approximated.wall_lower) - 4
    assert boxes.startswith(f"{number} boxes along the axes stand for geom 'turned', 'tilted', 'pillar', …; ")


def refused(path, approximate):
    with pytest.raises(pecjax.InputError) as caught:
        read_map_file(path, approximate)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("approximate", [0, -1, 1e-5, float("nan"), float("inf")])
def test_a_reach_that_is_none(folder, approximate):
    with pytest.raises(
        pecjax.InputError, match=r"^approximate is \S+; give metres, 0\.001 at least, 0\.05 say$"
    ):
        read_map_file(folder / "map.xml", approximate)


@pytest.mark.parametrize("shape", ["egg", "turned"])
def test_what_would_take_too_many_boxes_is_refused_by_name(shape, tmp_path):
    (tmp_path / "map.xml").write_text(world({shape: SHAPES[shape]}))
    message = refused(tmp_path / "map.xml", 1e-3)
    assert f"map.xml, line 6: geom '{shape}' cannot be approximated to 0.001 m: it " in message


@pytest.mark.parametrize(
    ("geom", "words"),
    [
        ('type="plane" size="0 0 1" euler="0 5 0"', "turned 5° off the axes"),
        ('type="hfield" hfield="hill"', "is a hfield"),
    ],
)
def test_what_is_no_convex_solid_stays_refused(geom, words, tmp_path):
    hill = '<asset><hfield name="hill" nrow="2" ncol="2" size="1 1 1 1"/></asset><worldbody>'
    path = tmp_path / "map.xml"
    path.write_text(
        world({"it": geom})
        .replace("<worldbody>", hill)
        .replace('euler="5 0 0"', "")
        .replace('euler="0 0 10"', "")
    )
    with pytest.raises(pecjax.InputError, match=words):
        pecjax.load_scene(path, approximate=0.1)


def test_mesh_files_are_bounded_and_missing_ones_named(folder, tmp_path):
    (tmp_path / "map.xml").write_text(world({"mesh": SHAPES["mesh"]}))
    assert "give --task.approximate 0.05 to have boxes in a mesh's place" in refused(
        tmp_path / "map.xml", None
    )
    assert "stone.obj" in refused(tmp_path / "map.xml", 0.1)
    (tmp_path / "stone.obj").write_text("#" * 2**22 + MESH)
    assert "stone.obj' is larger than 4,194,304 bytes" in refused(tmp_path / "map.xml", 0.1)
    (tmp_path / "stone.obj").write_text("v 0 0 0\n" * 9)
    assert "MuJoCo cannot compile it" in refused(tmp_path / "map.xml", 0.1)


def test_meshes_that_are_only_for_show_are_still_not_opened(tmp_path):
    shown = {"pillar": SHAPES["pillar"], "mesh": SHAPES["mesh"] + ' contype="0" conaffinity="0"'}
    (tmp_path / "map.xml").write_text(world(shown))
    assert "stone" not in read_map_file(tmp_path / "map.xml", 0.1).text


def test_a_flat_solid_is_refused():
    with pytest.raises(pecjax.InputError, match="flat"):
        cover(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]), 0.1, 9)


def test_the_numbers_of_boxes_in_the_docs(tmp_path):
    rows = re.findall(r"^\| `(type=.*?)` \| (\d+) \| (\d+) \|$", (ROOT / "docs/maps.md").read_text(), re.M)
    assert len(rows) == 4
    for geom, *numbers in rows:
        (tmp_path / "map.xml").write_text(world({"it": geom}).replace('euler="5 0 0"', "").replace(
            'euler="0 0 10"', "").replace('euler="0 0 -10"', ""))  # fmt: skip
        for reach, number in zip((0.1, 0.05), map(int, numbers), strict=True):
            found = int(read_map_file(tmp_path / "map.xml", reach).notices[-1].split()[0])
            assert abs(found - number) <= 0.1 * number, (geom, reach, found)
