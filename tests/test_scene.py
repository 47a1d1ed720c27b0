import jax
import numpy as np
import pytest
from jax import numpy as jnp

import pecjax
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.flight import hover, physics_step
from pecjax.envs.rooms.map_file import ENDLESS
from pecjax.envs.rooms.mjcf_file import read_map_file

CAMERA = (
    '<camera name="depth" pos="0.1 0 0" xyaxes="0 -1 0 0 0 1" fovy="73.7398" resolution="16 12"/>',
    "",
)
# Its length must match the joints, so it goes where a test changes these.
KEYFRAME = ('qpos="0 -2 1.2 1 0 0 0" ', "")
# At rest in the hall, looking along +x.
EAST = hover(jnp.array([0.0, -2.0, 1.2]), jnp.array(0.0))


def test_reads_the_walls_of_the_six_rooms(scene):
    assert scene.wall_lower.shape == scene.wall_upper.shape == (14, 3)
    assert len(set(scene.map.names)) == 14
    door = scene.map.names.index("west_b")
    np.testing.assert_allclose(scene.wall_lower[door], (-6.3, -0.3, 0), atol=1e-12)
    np.testing.assert_allclose(scene.wall_upper[door], (-6.1, 1, 2.5), atol=1e-12)


def test_reads_the_drone(scene):
    assert scene.drone_radius == 0.25
    assert scene.vehicle.mass == 1.477
    np.testing.assert_array_equal(scene.vehicle.inertia, (0.01152, 0.01152, 0.0218))


def test_reads_the_camera(scene):
    camera = scene.vehicle.camera
    assert (camera.width, camera.height, camera.near, camera.far) == (16, 12, 0.1, 10.0)
    np.testing.assert_allclose(camera.position, (0.1, 0, 0))
    # 73.74 degrees high at 4:3 is 90 degrees wide.
    np.testing.assert_allclose(np.tan(camera.fovy / 2) * 16 / 12, 1.0, atol=1e-5)
    right, up, backward = camera.rotation.T
    np.testing.assert_allclose([right, up, backward], [(0, -1, 0), (0, 0, 1), (-1, 0, 0)], atol=1e-12)


def test_rotor_wrench_is_force_and_lever_arm(scene):
    arm, reaction = 0.1945, 0.016
    # A thrust F along z at (x, y) turns about x by y·F and about y by -x·F.
    x, y = arm * np.array([1, -1, -1, 1]), arm * np.array([1, 1, -1, -1])
    expected = [np.ones(4), y, -x, reaction * np.array([1, -1, 1, -1])]
    np.testing.assert_allclose(scene.vehicle.rotors.wrench, expected, atol=1e-9)
    np.testing.assert_array_equal(scene.vehicle.rotors.lower, np.zeros(4))
    np.testing.assert_array_equal(scene.vehicle.rotors.upper, np.full(4, 8.0))


def test_reads_nested_and_turned_walls_and_passes_over_what_is_for_show(other_scene):
    corners = zip(other_scene.wall_lower, other_scene.wall_upper, strict=True)
    walls = dict(zip(other_scene.map.names, corners, strict=True))
    assert set(walls) == {"floor", "south", "north", "west", "east", "partition", "pillar"}
    expected = {
        "west": ((-4.15, -4, 0), (-3.85, 4, 3)),
        "east": ((5.9, -4, 0), (6.1, 4, 3)),
        # Turned by 90 degrees, a body at (1, 1) holds (x, y) at (1 - y, 1 + x).
        "partition": ((0.65, -1, 0), (0.85, 4, 2)),
        "pillar": ((2.3, -2.3, 0), (2.7, -1.7, 1.4)),
    }
    for name, box in expected.items():
        np.testing.assert_allclose(walls[name], box, atol=1e-6, err_msg=name)
    assert (other_scene.drone_radius, other_scene.vehicle.mass) == (0.18, 0.9)
    assert (other_scene.vehicle.camera.width, other_scene.vehicle.camera.height) == (20, 11)
    assert (other_scene.vehicle.camera.near, other_scene.vehicle.camera.far) == (0.2, 6.0)


def test_what_is_only_for_show_may_need_files_which_are_never_opened(scene, edited_rooms):
    assets = """<asset><mesh name="hat" file="hat.obj"/><hfield name="hill" file="hill.png" size="1 1 1 1"/>
      <texture name="wood" type="2d" file="wood.png"/><texture type="skybox" fileup="sky.png"/>
      <material name="wooden" texture="wood"/></asset><worldbody>
      <geom type="mesh" mesh="hat" contype="0" conaffinity="0" material="wooden"/>
      <geom type="hfield" hfield="hill" contype="0" conaffinity="0"/>"""
    path = edited_rooms(("<worldbody>", assets), (HULL, HULL_MESH), (WALL, WALL + ' material="wooden"'))
    shown = pecjax.load_scene(path)
    for name in ("wall_lower", "wall_upper"):
        np.testing.assert_array_equal(getattr(shown, name), getattr(scene, name))
    for name in ("mass", "inertia"):
        np.testing.assert_array_equal(getattr(shown.vehicle, name), getattr(scene.vehicle, name))
    assert shown.map.names == scene.map.names
    kept = read_map_file(path).text
    assert "file=" not in kept and 'mesh="hat"' not in kept


def test_a_plane_is_the_half_space_behind_it(edited_rooms):
    ground = '<geom name="ground" type="plane" size="3 3 1" pos="1 1 0.2"/>'
    west = '<geom name="west" type="plane" size="0 0 1" pos="-12 0 0" zaxis="1 0 0"/>'
    scene = pecjax.load_scene(edited_rooms(("<light", f"{ground}{west}<light")))
    walls = [scene.map.names.index(name) for name in ("ground", "west")]
    far = ENDLESS
    np.testing.assert_allclose(scene.wall_lower[walls], [(-far, -far, -far), (-far, -far, -far)])
    np.testing.assert_allclose(scene.wall_upper[walls], [(far, far, 0.2), (-12, far, far)])
    # The map is as large as its boxes, and as far as the plane that stands.
    np.testing.assert_allclose(scene.map.bounds, [(-12, -10.1), (8.1, 8.1)])


def test_bounds_are_those_of_the_boxes(scene, other_scene):
    for which in (scene, other_scene):
        corners = np.concatenate([which.wall_lower, which.wall_upper])[:, :2]
        np.testing.assert_array_equal(which.map.bounds, [corners.min(axis=0), corners.max(axis=0)])


def test_a_map_and_the_map_that_is_saved_of_it_are_the_same(edited_rooms, other_map, tmp_path):
    """Byte for byte, however many digits the numbers of a map have."""
    rng = np.random.default_rng(0)
    saved = tmp_path / "saved.xml"
    for path in (other_map, *(edited_rooms(*odd_edits(rng)) for _ in range(40))):
        saved.write_text(read_map_file(path).text)
        given, kept = read_map_file(path), read_map_file(saved)
        assert kept.text == given.text
        for name in ("geom_pos", "geom_size", "geom_quat", "body_inertia", "cam_quat"):
            np.testing.assert_array_equal(getattr(kept.model, name), getattr(given.model, name))


def odd_edits(rng):
    """Walls and a camera whose numbers have more digits than are saved."""

    def numbers(count):
        return " ".join(repr(float(x)) for x in rng.uniform(size=count) * 10 ** rng.uniform(-3, 0.5))

    turns = " ".join(map(str, rng.choice([0, 1.5707963267948966], 3)))
    box = f'<geom type="box" pos="{numbers(3)}" size="{numbers(3)}"/>'
    return (
        ("<worldbody>", f'<worldbody><body pos="{numbers(3)}" euler="{turns}">{box}</body>'),
        ('xyaxes="0 -1 0 0 0 1"', f'euler="{numbers(3)}"'),
    )


def test_resolution_may_be_asked_for():
    scene = pecjax.load_scene(resolution=(64, 48))
    assert (scene.vehicle.camera.width, scene.vehicle.camera.height) == (64, 48)
    assert pecjax.depth_image(scene, *np.split(EAST.qpos, [3])).shape == (48, 64)


def test_moving_a_wall_moves_what_is_seen_and_what_is_hit(scene, edited_rooms):
    moved = pecjax.load_scene(edited_rooms(('name="outer_east" pos="8 ', 'name="outer_east" pos="5 ')))
    spot = jnp.array([4.5, -2.0, 1.2])
    for which, face in ((scene, 7.9), (moved, 4.9)):
        seen = pecjax.depth_image(which, EAST.qpos[:3], EAST.qpos[3:])
        np.testing.assert_allclose(seen[5:7, 7:9], face - 0.1, atol=1e-5)
        expected = min(face - 4.5, 1.9)  # the east wall, or the south wall's face at y = -3.9
        np.testing.assert_allclose(wall_distance(which.walls, spot), expected, atol=1e-5)


def test_turning_and_shifting_the_camera_changes_what_is_seen(edited_rooms):
    backward = pecjax.load_scene(
        edited_rooms(('pos="0.1 0 0" xyaxes="0 -1 0 0 0 1"', 'pos="-0.3 0 0" xyaxes="0 1 0 0 0 1"'))
    )
    seen = pecjax.depth_image(backward, EAST.qpos[:3], EAST.qpos[3:])
    # The wall x = -6.2 has its face at -6.1; the pixels right of the middle look through its door.
    np.testing.assert_allclose(seen[5:7, 6:8], 6.1 - 0.3, atol=1e-5)


def test_mass_inertia_and_rotor_arms_move_the_physics(scene, edited_rooms):
    other = pecjax.load_scene(
        edited_rooms(
            ('mass="1.477"', 'mass="2.954"'),
            ('diaginertia="0.01152 ', 'diaginertia="0.02304 '),
            ('name="rotor_1" pos="0.1945 0.1945', 'name="rotor_1" pos="0.1945 0.389'),
        )
    )
    dt = scene.model.opt.timestep
    for which, mass, roll in ((scene, 1.477, 0.1945 / 0.01152), (other, 2.954, 0.389 / 0.02304)):
        velocity = jax.jit(lambda u, s=which: physics_step(s.vehicle, EAST, u).qvel)(
            jnp.array([1.0, 0, 0, 0])
        )
        np.testing.assert_allclose(velocity[2:4], [(1 / mass - 9.81) * dt, roll * dt], rtol=1e-4)


def test_what_hangs_on_the_drone_as_a_body_of_its_own_is_refused(edited_rooms):
    # The controller would lift the drone alone, while MuJoCo moves all that is welded to it.
    payload = '<body><inertial pos="0 0 0" mass="0.5" diaginertia="0.001 0.001 0.001"/></body>'
    with pytest.raises(pecjax.InputError, match="the drone must be one body"):
        pecjax.load_scene(edited_rooms(('<camera name="depth"', payload + '<camera name="depth"')))


MESH = ("<worldbody>", '<asset><mesh name="hat" file="hat.obj"/></asset><worldbody>')
INERTIAL = '<inertial pos="0 0 0" mass="1.477" diaginertia="0.01152 0.01152 0.0218"/>'
HULL = '<geom class="visual" name="hull" type="ellipsoid" size="0.12 0.08 0.05"/>'
HULL_MESH = '<geom class="visual" name="hull" type="mesh" mesh="hat"/>'
WALL = 'name="north_b" pos="-3 1 1.25" size="1.3 0.1 1.25"'
BALL = 'type="sphere" size="0.25"'
BAD_MAPS = {
    "MuJoCo refuses it": (
        [('type="ellipsoid"', 'type="egg"')],
        "MuJoCo cannot compile it: XML Error: invalid keyword: 'egg' Element 'geom', line 67",
    ),
    "MuJoCo refuses a size": (
        [('pos="-10 -1 1.25" size="0.1', 'pos="-10 -1 1.25" size="0')],
        "Element name 'outer_west', id 0, line 35",
    ),
    "no drone": ([('<body name="drone"', '<body name="bird"')], "no body named 'drone'"),
    "no camera": ([CAMERA], "no camera"),
    "a wall is a sphere": (
        [(WALL, WALL + ' type="sphere"')],
        "line 42: geom 'north_b' collides and is a sphere; only boxes and planes can be walls",
    ),
    "a wall is turned": ([(WALL, WALL + ' euler="0 0 0.3"')], "geom 'north_b' collides and is turned 17.2°"),
    "a wall leans": ([(WALL, WALL + ' euler="0.01 0 0"')], "geom 'north_b' collides and is turned 0.573°"),
    "the ground leans": (
        [("<light", '<geom name="ground" type="plane" size="9 9 1" euler="0 0.1 0"/><light')],
        "geom 'ground' collides and is turned 5.73°",
    ),
    "a wall is a mesh": (
        [MESH, (WALL, WALL + ' type="mesh" mesh="hat"')],
        "geom 'north_b' collides and needs the file 'hat.obj'",
    ),
    "a wall is endless": ([(WALL, WALL.replace("1.3 0.1", "1300 0.1"))], "wall 'north_b' reaches beyond"),
    "a wall on a mocap body": (
        [("<light", '<body mocap="true"><geom name="hand" type="box" size="1 1 1"/></body><light')],
        "geom 'hand' collides on a mocap body",
    ),
    "only planes are walls": (
        [
            ('conaffinity="1" condim="1" group="0"', 'conaffinity="0" condim="1" group="0"'),
            ("<light", '<geom type="plane" size="9 9 1"/><light'),
        ],
        "at least one box",
    ),
    "the drone's mass is in a file": (
        [MESH, (INERTIAL, ""), (HULL, HULL_MESH.replace("/>", ' mass="1"/>'))],
        "geom 'hull' needs the file 'hat.obj', which is not read, and the drone's mass depends on it",
    ),
    "no walls": (
        [('conaffinity="1" condim="1" group="0"', 'conaffinity="0" condim="1" group="0"')],
        "no wall",
    ),
    "no free joint": ([('<freejoint name="drone"/>', ""), KEYFRAME], "free joint"),
    "an extra joint": (
        [("<light", '<body name="door"><joint name="hinge"/><geom size="0.1"/></body><light'), KEYFRAME],
        "line 32: joint 'hinge' of the body 'door' moves it, and nothing else may move",
    ),
    "the drone is a box": ([(BALL, 'type="box" size="0.2 0.2 0.1"')], "a sphere at its origin"),
    "no collision geom": (
        [('<geom class="collision" name="drone" ' + BALL + "/>", "")],
        "a sphere at its origin",
    ),
    "two geoms of the drone collide": (
        [('<geom class="visual" name="hull"', '<geom class="collision" name="hull"')],
        "line 67: geom 'hull' is one of 2 that collide",
    ),
    "the drone is a hinge": ([('<freejoint name="drone"/>', "<joint/>"), KEYFRAME], "needs one free joint"),
    "the sphere is off the origin": ([(BALL, BALL + ' pos="0 0 0.1"')], "a sphere at its origin"),
    "a child of the drone collides": (
        [('<camera name="depth"', '<body><geom size="0.3" mass="0"/></body><camera name="depth"')],
        "the drone must be one body",
    ),
    "a tendon holds the drone": (
        [
            ("</worldbody>", '<site name="hook" pos="0 0 2"/></worldbody>'),
            (
                "<actuator>",
                '<tendon><spatial stiffness="9"><site site="hook"/><site site="rotor_1"/></spatial></tendon>'
                "<actuator>",
            ),
        ],
        "a tendon has stiffness, and nothing may hold the drone",
    ),
    "rotors too weak": ([('ctrlrange="0 8"', 'ctrlrange="0 3"')], "weight of 14.5 N"),
    "rotors without limits": ([('ctrlrange="0 8"', "")], "ctrlrange"),
    "rotors that only pull down": ([('ctrlrange="0 8"', 'ctrlrange="-8 0"')], "reaches above 0"),
    "rotors that cannot yaw": ([('0.016"', '0"')], "yaw"),
    "rotors with lag": (
        [('<general ctrlrange="0 8"', '<general dyntype="filterexact" dynprm="0.03" ctrlrange="0 8"')],
        "without state",
    ),
    "centre of mass off the origin": (
        [('<inertial pos="0 0 0"', '<inertial pos="0.02 0 0"')],
        "centre of mass",
    ),
    "principal axes turned": (
        [('diaginertia="0.01152 0.01152 0.0218"', 'fullinertia="0.012 0.013 0.02 0.002 0 0"')],
        "principal axes",
    ),
    "depth range falls": ([('data="0.1 10"', 'data="5 1"')], "depth_range"),
    "depth range is one number": ([('data="0.1 10"', 'data="0.1"')], "depth_range"),
}


@pytest.mark.parametrize("case", BAD_MAPS)
def test_a_bad_map_is_refused_by_name(case, edited_rooms):
    edits, message = BAD_MAPS[case]
    path = edited_rooms(*edits)
    with pytest.raises(pecjax.InputError) as caught:
        pecjax.load_scene(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)  # the command line prints it as one line


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such scene file"),
        (b"walls: none", "not XML"),
        (b"<mujoco><worldbody>", "not XML"),
        (b"\x80\x03\x00\xff" * 9, "not XML"),
        (b"", "not XML"),
        (b"<html/>", "MuJoCo cannot compile"),
    ],
)
def test_a_file_that_is_no_map_is_refused(content, message, tmp_path):
    path = tmp_path / "map.xml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(pecjax.InputError, match=message) as caught:
        pecjax.load_scene(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
