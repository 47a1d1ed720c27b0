"""Fixtures shared by the tests: scenes, an environment, and maps made by editing the shipped one."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pecjax
from pecjax.envs.rooms import task
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.flight import DroneState
from pecjax.envs.rooms.map_file import ENDLESS
from pecjax.envs.rooms.rotations import heading, heading_to_quaternion
from pecjax.envs.rooms.scene import default_scene_path

# The tests of several devices need four, and CPUs can pretend to be. JAX has not started yet: importing
# pecjax does not (`test_architecture.py`).
jax.config.update("jax_num_cpu_devices", 4)

# What one test has compiled serves the others, those of other processes and the next run of the tests:
# JAX tells programs apart by what they are. An entry that is being written is compiled again.
COMPILED = Path(__file__).parents[1] / ".pytest_cache" / "pecjax" / "compiled"
jax.config.update("jax_compilation_cache_dir", str(COMPILED))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_logging_level", "CRITICAL")  # see `devices.keep_compiled_programs`


def pytest_configure(config):
    """The core suite is mostly compilation, of programs that then run for moments.

    Its programs are compiled as those of JAX's own tests; the slow suite's, and those of processes that
    tests start, as a user's.
    """
    jax.config.update("jax_disable_most_optimizations", config.option.markexpr == "not slow")


# Differs from rooms.xml in all that a map may choose: a floor, walls that hang in bodies or are turned
# by right angles, something there only for show, and another drone with another camera.
OTHER_MAP = """
<mujoco model="other">
  <compiler angle="degree" autolimits="true"/>
  <option timestep="0.01"/>
  <custom><numeric name="depth_range" data="0.2 6"/></custom>
  <worldbody>
    <geom name="floor" type="box" pos="1 0 -0.05" size="5 4 0.05"/>
    <geom name="south" type="box" pos="1 -4 1.5" size="5 0.15 1.5"/>
    <geom name="north" type="box" pos="1 4 1.5" size="5 0.15 1.5"/>
    <geom name="west" type="box" pos="-4 0 1.5" size="4 0.15 1.5" euler="0 0 90"/>
    <geom name="east" type="box" pos="6 0 1.5" size="1.5 4 0.1" euler="0 90 0"/>
    <body name="partition" pos="1 1 0" euler="0 0 90">
      <geom name="partition" type="box" pos="0.5 0.25 1" size="2.5 0.1 1"/>
      <body pos="-3 0 0">
        <geom name="pillar" type="box" pos="0 -1.5 0.7" size="0.3 0.2 0.7"/>
      </body>
    </body>
    <geom name="for_show" type="box" pos="3 -1 1" size="0.4 0.4 1" contype="0" conaffinity="0" group="2"/>
    <body name="drone" pos="-2 0 1">
      <freejoint/>
      <inertial pos="0 0 0" mass="0.9" diaginertia="0.008 0.009 0.015"/>
      <geom type="sphere" size="0.18" mass="0"/>
      <site name="a" pos="0.12 0.15 0"/>
      <site name="b" pos="-0.12 0.15 0"/>
      <site name="c" pos="-0.12 -0.15 0"/>
      <site name="d" pos="0.12 -0.15 0"/>
      <camera name="eye" pos="0.08 0.03 -0.05" xyaxes="0 -1 0 0.5 0 0.8660254" fovy="58" resolution="20 11"/>
    </body>
  </worldbody>
  <actuator>
    <general site="a" gear="0 0 1 0 0 0.02" ctrlrange="0 6"/>
    <general site="b" gear="0 0 1 0 0 -0.02" ctrlrange="0 6"/>
    <general site="c" gear="0 0 1 0 0 0.02" ctrlrange="0 6"/>
    <general site="d" gear="0 0 1 0 0 -0.02" ctrlrange="0 6"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="session")
def scene():
    return pecjax.load_scene()


@pytest.fixture(scope="session")
def env(scene):
    return pecjax.RoomsNavigation(scene)


@pytest.fixture(scope="session")
def other_map(tmp_path_factory):
    path = tmp_path_factory.mktemp("maps") / "other.xml"
    path.write_text(OTHER_MAP)
    return path


@pytest.fixture(scope="session")
def other_scene(other_map):
    return pecjax.load_scene(other_map)


@pytest.fixture(scope="session")
def plane_scene(tmp_path_factory):
    """The other map with a plane for its floor, and one for its west wall."""
    boxes = OTHER_MAP
    for name, plane in (("floor", 'pos="1 0 0"'), ("west", 'pos="-3.85 0 0" zaxis="1 0 0"')):
        start = boxes.index(f'<geom name="{name}"')
        box = boxes[start : boxes.index("/>", start)]
        boxes = boxes.replace(box, f'<geom name="{name}" type="plane" size="0 0 1" {plane}')
    path = tmp_path_factory.mktemp("maps") / "planes.xml"
    path.write_text(boxes)
    return pecjax.load_scene(path)


def extent(scene):
    """The corners (3,) m between which all walls end that do end."""
    corners = np.concatenate([scene.wall_lower, scene.wall_upper])
    ends = np.abs(corners) < ENDLESS
    low, high = (np.where(ends, corners, missing) for missing in (np.inf, -np.inf))
    return low.min(axis=0), high.max(axis=0)


@pytest.fixture(scope="session")
def edited_rooms(tmp_path_factory):
    """(old, new), … -> path of a copy of rooms.xml with these pieces of text replaced."""
    folder = tmp_path_factory.mktemp("edited")
    rooms = default_scene_path().read_text()

    def edit(*replacements):
        text = rooms
        for old, new in replacements:
            assert old in text, f"rooms.xml no longer contains {old!r}"
            text = text.replace(old, new)
        path = folder / f"map_{len(list(folder.iterdir()))}.xml"
        path.write_text(text)
        return path

    return edit


@pytest.fixture(scope="session")
def step(env):
    """`env.step`, compiled once for every test that flies."""
    return jax.jit(env.step)


def glide(vehicle, walls, gains, state, command, num_steps, conditions):
    """`flight.fly` without physics: the drone takes on the speed and the yaw rate at once."""
    period = num_steps * vehicle.timestep
    looking = heading(state.qpos[3:]) + period * command.yaw_rate
    velocity = command.speed * jnp.stack([jnp.cos(looking), jnp.sin(looking), jnp.zeros_like(looking)])
    position = state.qpos[:3] + period * velocity
    qpos = jnp.concatenate([position, heading_to_quaternion(looking)])
    return DroneState(qpos, jnp.concatenate([velocity, jnp.zeros(3)])), wall_distance(walls, position)


@pytest.fixture(scope="module")
def gliding():
    """For tests of what happens around flights: their programs compile in less than half the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(task, "fly", glide)
        yield


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Where runs go."""
    return tmp_path_factory.mktemp("runs")
