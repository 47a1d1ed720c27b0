"""The optional axes of the rooms: each does in an episode what its column says."""

from pathlib import Path

import jax
import numpy as np
import pytest
from contract_task import check_task
from jax import numpy as jnp

import pecjax
from pecjax.envs.axes import axes_of, columns_of, make_table
from pecjax.envs.configuration_files import table_text
from pecjax.envs.rooms.camera_errors import with_errors
from pecjax.envs.rooms.config import HOLD, MAX_LATENCY, REACH, VIA
from pecjax.envs.rooms.maps import make_bank
from pecjax.envs.rooms.task import STAND_STILL, RoomsParams, RoomsTask
from pecjax.envs.task import World, take_configs

OPTIONAL = {name: about for name, about in axes_of(pecjax.Configurations).items() if about.optional}
START, GOAL = [[0, -2]], [[5, -2]]
AHEAD, LEFT = 12, 14
ACTIONS = [AHEAD, AHEAD, LEFT, LEFT, STAND_STILL, AHEAD, LEFT, AHEAD, AHEAD, LEFT, AHEAD, STAND_STILL]


def table_with(**values):
    values = {name: np.asarray(value)[None] for name, value in values.items()}
    return make_table(pecjax.Configurations, start=np.array(START), goal=np.array(GOAL), **values)


@pytest.fixture(scope="module")
def task(scene):
    return RoomsTask(scene.vehicle)


@pytest.fixture(scope="module")
def params(scene):
    return RoomsParams(make_bank([scene.map]))


@pytest.fixture(scope="module")
def fly(task, params):
    """(table, key, actions) -> states after each action, the first state leading, and images."""

    @jax.jit
    def fly(config, key, actions):
        first = task.reset(key, config, params)

        def step(state, action_and_key):
            action, key = action_and_key
            state = task.step(key, state, action, params).state
            return state, (state.qpos, task.observe(key, state, params)["depth"])

        keys = jax.random.split(key, len(actions))
        return first.qpos, jax.lax.scan(step, first, (actions, keys))[1]

    def run(table, seed=0, actions=ACTIONS):
        first, (qpos, depth) = fly(take_configs(table, 0), jax.random.key(seed), jnp.asarray(actions))
        return np.concatenate([first[None], qpos]), np.asarray(depth)

    return run


def test_absent_axes_are_no_leaves():
    table = table_with()
    assert len(jax.tree.leaves(table)) == 3 and all(getattr(table, name) is None for name in OPTIONAL)


@pytest.mark.parametrize("name", [name for name in OPTIONAL if name not in ("wind", "gust", "heading")])
def test_the_least_effect_is_none(name, fly):
    """Wind and gust need air, which has drag, and a heading is no longer drawn."""
    neutral = np.full(len(OPTIONAL[name].columns), OPTIONAL[name].default, OPTIONAL[name].dtype)
    expected, seen = fly(table_with())
    qpos, depth = fly(table_with(**{name: neutral if neutral.size > 1 else neutral[0]}))
    np.testing.assert_allclose(qpos, expected, atol=2e-5)
    np.testing.assert_allclose(depth, seen, atol=2e-5)


def test_all_axes_at_once_keep_to_the_contract_of_tasks(scene, params):
    table = make_table(
        pecjax.Configurations,
        start=np.repeat(START, 4, axis=0),
        goal=np.repeat(GOAL, 4, axis=0),
        heading=np.linspace(-3, 3, 4),
        wind=np.array([[0, 0, 0], [2, 0, 0], [0, -3, 0], [0, 0, 1]]),
        gust=np.linspace(0, 2, 4),
        payload=np.linspace(0, 0.4, 4),
        motor_strength=np.linspace(1, 0.8, 4),
        visibility=np.array([1000, 5, 2, 1]),
        depth_noise=np.linspace(0, 0.1, 4),
        depth_dropout=np.linspace(0, 0.2, 4),
        latency=np.arange(4),
        objective=np.array([REACH, HOLD, VIA, REACH]),
        waypoint=np.full((4, 2), -2),
    )
    assert not [name for name in OPTIONAL if getattr(table, name) is None]
    task = RoomsTask(scene.vehicle, objectives=True)
    assert check_task(task, World(params, table), steps=30) > 0


def test_a_heading_is_where_the_drone_looks_at_first(fly):
    for heading in (-2.0, 0.5):
        w, _, _, z = fly(table_with(heading=heading))[0][0, 3:]
        assert 2 * np.arctan2(z, w) == pytest.approx(heading, abs=1e-6)


@pytest.mark.parametrize("latency", [1, 3, MAX_LATENCY])
def test_latency_is_the_same_flight_later(latency, fly):
    """Until then the drone stands still, which it does to rounding."""
    early, _ = fly(table_with(heading=1.0), actions=ACTIONS + [STAND_STILL] * latency)
    late, _ = fly(table_with(heading=1.0, latency=latency), actions=ACTIONS + [STAND_STILL] * latency)
    np.testing.assert_allclose(late[latency:], early[: len(late) - latency], atol=1e-4)
    np.testing.assert_allclose(late[: latency + 1], np.repeat(late[:1], latency + 1, axis=0), atol=1e-4)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"drag": (0.1, -0.1, 0.1)}, r"drag is \(.*\); give three numbers"),
        ({"drag": (0.1, 0.1)}, r"drag is \(.*\); give three numbers"),
        ({"gust_time": 0.0}, "gust-time is 0; give more than 0"),
    ],
)
def test_air_that_cannot_be_gets_one_line(wrong, said, scene):
    with pytest.raises(pecjax.InputError, match=said):
        RoomsTask(scene.vehicle, pecjax.NavigationSettings(**wrong))


def test_gusts_are_drawn_anew_in_every_episode_and_the_same_from_one_key(fly):
    table = table_with(heading=1.0, gust=3.0)
    first, again, other = (fly(table, seed)[0] for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first[:, :3] - other[:, :3]).max() > 0.02


def test_wind_blows_the_drone_off_its_course(fly):
    winds = ([0, 0, 0], [4, 0, 0])
    still, east = (fly(table_with(heading=np.pi / 2, wind=wind), actions=[AHEAD] * 10)[0] for wind in winds)
    assert east[-1, 0] - still[-1, 0] > 0.1


@pytest.fixture(scope="module")
def camera(scene):
    return scene.vehicle.camera


def spoilt(camera, depth, seed=0, **axes):
    config = take_configs(table_with(**axes), 0)
    return np.asarray(with_errors(camera, config, jax.random.key(seed), jnp.asarray(depth, jnp.float32)))


def test_fog_hides_what_lies_beyond_it(camera):
    depth = np.linspace(camera.near, camera.far, 192).reshape(12, 16).astype(np.float32)
    expected = np.where(depth > np.float32(3), np.float32(camera.far), depth)
    np.testing.assert_array_equal(spoilt(camera, depth, visibility=3.0), expected)


def test_noise_grows_with_the_depth_and_leaves_no_reading_alone(camera):
    for depth in (1.0, 4.0):
        image = np.full((12, 16), depth)
        found = np.stack([spoilt(camera, image, seed, depth_noise=0.02) for seed in range(50)])
        assert found.mean() == pytest.approx(depth, rel=1e-3)
        assert found.std() == pytest.approx(0.02 * depth, rel=0.03)
    none = np.full((12, 16), camera.far, np.float32)
    np.testing.assert_array_equal(spoilt(camera, none, depth_noise=0.5), none)
    near = spoilt(camera, np.full((12, 16), camera.near), depth_noise=1.0)
    assert near.min() >= np.float32(camera.near) and near.max() <= camera.far


def test_dropout_is_that_share_of_pixels(camera):
    found = np.stack([spoilt(camera, np.full((12, 16), 2.0), seed, depth_dropout=0.1) for seed in range(50)])
    assert set(np.unique(found)) == {np.float32(2), np.float32(camera.far)}
    assert (found == camera.far).mean() == pytest.approx(0.1, abs=0.01)  # deviation 0.003
    assert (found[0] != found[1]).any()


def test_the_docs_name_every_column():
    text = (Path(__file__).parents[1] / "docs" / "maps.md").read_text()
    assert not [column for column in columns_of(pecjax.Configurations) if f"`{column}`" not in text]


def test_files_may_have_any_of_the_columns_and_keep_them(tmp_path):
    file = tmp_path / "storm.csv"
    header = "start_x,start_y,goal_x,goal_y,latency"
    file.write_text(f"{header},wind_x,wind_y,wind_z\n0,-2,5,-2,2,1,0,0\n5,-2,0,-2,0,0,0,0\n")
    table = pecjax.load_coordinates(file)
    np.testing.assert_array_equal(table.wind, [[1, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(table.latency, [2, 0])
    assert table.gust is None and table.latency.dtype == np.int32
    file.write_text(table_text(table.replace(wind=np.zeros((2, 3), np.float32))))
    again = pecjax.load_coordinates(file)
    np.testing.assert_array_equal(again.wind, np.zeros((2, 3)))  # at its default, and yet there
    file.write_text(f"{header}\n0,-2,5,-2,11\n")
    with pytest.raises(pecjax.InputError, match=r"line 2, column 5: latency is 11; .* to 10 control steps"):
        pecjax.load_coordinates(file)
