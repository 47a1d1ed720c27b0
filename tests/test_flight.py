"""Flight against C MuJoCo, against the published figures of such controllers, and against itself."""

from itertools import pairwise

import jax
import mujoco
import numpy as np
import pytest
from conftest import OTHER_MAP
from jax import numpy as jnp
from scipy import signal

import pecjax
from pecjax.envs.rooms.controller import Command, allocate_rotors
from pecjax.envs.rooms.flight import Conditions, DroneState, fly, hover, physics_step, rotor_controls
from pecjax.envs.rooms.maps import FEW_WALLS, Walls
from pecjax.envs.rooms.rotations import heading

HEIGHT = 1.2
QUARTER, EIGHTH = np.pi / 2, np.pi / 4
# Name -> (seconds, speed m/s, yaw rate rad/s), …
FLIGHTS = {
    "hover": [(10, 0, 0)],
    "steps": [(1, 0, 0), (3, 1, 0), (3, 2, 0), (3, 0, 0)],
    "yaw": [(1, 0, 0), (9, 0, QUARTER)],
    "left turn": [(2, 2, 0), (8, 2, QUARTER)],
    "right turn": [(2, 2, 0), (8, 2, -QUARTER)],
    "varied": [
        (1, 0, 0), (1, 2, 0), (1, 2, QUARTER), (1, 2, -EIGHTH), (1, 1, -QUARTER),
        (1, 0, QUARTER), (1, 1, EIGHTH), (1, 2, 0), (1, 2, QUARTER), (1, 0, 0),
    ],
}  # fmt: skip


def commands(timestep):
    def spread(field):
        return [
            np.concatenate([np.full(round(part[0] / timestep), part[field]) for part in parts])
            for parts in FLIGHTS.values()
        ]

    return np.array(spread(1), float), np.array(spread(2), float)


def start(dtype=np.float32):
    return hover(jnp.array([0, 0, HEIGHT], dtype), jnp.zeros((), dtype))


def fly_all(scene, gains=pecjax.ControllerGains(), dtype=np.float32):
    """name -> (qpos, qvel, controls) after each physics step, flown by MJX."""

    def fly(state, speeds, yaw_rates):
        def step(state, command):
            controls = rotor_controls(scene.vehicle, gains, state, Command(*command, HEIGHT))
            state = physics_step(scene.vehicle, state, controls)
            return state, (*state, controls)

        return jax.lax.scan(step, state, (speeds, yaw_rates))[1]

    asked = (jnp.asarray(c, dtype) for c in commands(scene.model.opt.timestep))
    flown = jax.jit(jax.vmap(fly, in_axes=(None, 0, 0)))(start(dtype), *asked)
    return {name: tuple(np.asarray(x[n]) for x in flown) for n, name in enumerate(FLIGHTS)}


def replay(model, controls, first, force=None):
    """qpos, qvel after each step of C MuJoCo under recorded controls, and a force (3,) N of qpos and qvel."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = first
    states = []
    for row in controls:
        data.ctrl[:] = row
        if force is not None:
            data.xfrc_applied[model.body("drone").id, :3] = force(data.qpos, data.qvel)
        mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.split(np.array(states), [7], axis=1)


def slip(qpos, qvel):
    """Degrees that the drone flies to the left of where it looks."""
    course = np.arctan2(qvel[:, 1], qvel[:, 0]) - np.asarray(jax.vmap(heading)(qpos[:, 3:]))
    return np.degrees((course + np.pi) % (2 * np.pi) - np.pi)


@pytest.fixture(scope="module")
def flights(scene):
    return fly_all(scene)


@pytest.fixture(scope="module")
def flights_without_feed_forward(scene):
    return fly_all(scene, pecjax.ControllerGains(turn_feed_forward=False))


def test_ten_seconds_open_loop_match_c_mujoco(scene, flights):
    qpos, qvel, controls = flights["varied"]
    expected_qpos, expected_qvel = replay(scene.model, controls, start())
    assert np.linalg.norm(np.diff(qpos[:, :3], axis=0), axis=1).sum() > 10  # a flight worth the name
    # Nothing steers a replay back: a float32 torque error of 1e-7 N m grows with the fourth power of
    # time into 1e-3 m after 10 s (measured: 0.9 mm; 8e-6 m after 2 s). The next test leaves no such room.
    np.testing.assert_allclose(qpos[:, :3], expected_qpos[:, :3], atol=5e-3)
    np.testing.assert_allclose(qpos[:100, :3], expected_qpos[:100, :3], atol=5e-5)
    np.testing.assert_allclose(qpos[:, 3:], expected_qpos[:, 3:], atol=1e-4)
    np.testing.assert_allclose(qvel, expected_qvel, atol=2e-3)


@pytest.mark.parametrize("which", ["six rooms", "other map"])
def test_in_double_precision_the_match_is_to_rounding(which, other_map):
    with jax.enable_x64(True):
        scene = pecjax.load_scene(None if which == "six rooms" else other_map)
        qpos, qvel, controls = fly_all(scene, dtype=np.float64)["varied"]
        first = start(np.float64)
    expected_qpos, expected_qvel = replay(scene.model, controls, first)
    np.testing.assert_allclose(qpos, expected_qpos, atol=1e-9)  # measured: 6e-12
    np.testing.assert_allclose(qvel, expected_qvel, atol=1e-9)


def test_the_controller_flies_c_mujoco_as_it_flies_mjx(scene, flights):
    controller = jax.jit(lambda *args: rotor_controls(scene.vehicle, pecjax.ControllerGains(), *args))
    data = mujoco.MjData(scene.model)
    data.qpos[:] = start().qpos
    speeds, yaw_rates = (c[list(FLIGHTS).index("varied")] for c in commands(scene.model.opt.timestep))
    states = []
    for speed, yaw_rate in zip(np.float32(speeds), np.float32(yaw_rates), strict=True):
        state = DroneState(np.float32(data.qpos), np.float32(data.qvel))
        data.ctrl[:] = controller(state, Command(speed, yaw_rate, HEIGHT))
        mujoco.mj_step(scene.model, data)
        states.append(data.qpos.copy())
    # Under feedback rounding does not grow, but place and heading are not held: measured 2e-6.
    np.testing.assert_allclose(flights["varied"][0], states, atol=1e-4)


def test_hover_stays_put(flights):
    qpos, qvel, _ = flights["hover"]
    assert np.abs(qpos[:, :3] - start().qpos[:3]).max() < 1e-4
    assert np.abs(qvel).max() < 1e-4


def test_speed_steps_answer_as_published(scene, flights):
    """Bands about the survey's figures for gains 3/130/30: t63 0.46 s, stop within 0.72 m."""
    qpos, qvel, _ = flights["steps"]
    second = round(1 / scene.model.opt.timestep)
    speed, along = qvel[:, 0], qpos[:, 0]
    for begin, old, new in ((1, 0, 1), (4, 1, 2)):
        part = (speed[begin * second : (begin + 3) * second] - old) / (new - old)
        assert 0.40 < np.argmax(part > 1 - np.exp(-1)) / second < 0.52
        assert abs(part[-1] - 1) < 0.01
        # The survey measured 4 %; the linear loop below, from first principles, has 10 %.
        gains = pecjax.ControllerGains()
        poles = [1, gains.body_rate, gains.attitude, gains.attitude * gains.velocity]
        linear = signal.step(([poles[3]], poles), T=np.linspace(0, 3, 301))[1].max() - 1
        assert abs(part.max() - 1 - linear) < 0.02
        assert part.max() < 1.12
    stop = along[7 * second :].max() - along[7 * second - 1]
    assert 0.65 < stop < 0.80
    assert abs(speed[-1]) < 0.005
    assert np.abs(qpos[:, 2] - HEIGHT).max() < 0.03
    assert np.abs(qpos[:, 1]).max() < 1e-4  # no command to the side


def test_yaw_rate_step_is_quick_and_turns_on_the_spot(scene, flights):
    qpos, qvel, _ = flights["yaw"]
    second = round(1 / scene.model.opt.timestep)
    rate = qvel[second:, 5] / QUARTER
    # A gain of 8/s is a first-order lag of 1/8 s.
    assert 0.08 < np.argmax(rate > 1 - np.exp(-1)) / second < 0.16
    assert rate.max() < 1.02
    assert abs(rate[-1] - 1) < 1e-3
    assert np.abs(qpos[:, :3] - start().qpos[:3]).max() < 1e-3


@pytest.mark.parametrize(("turn", "side"), [("left turn", 1), ("right turn", -1)])
def test_turns_keep_to_the_heading_with_feed_forward(scene, flights, turn, side):
    qpos, qvel, _ = flights[turn]
    second = round(1 / scene.model.opt.timestep)
    assert np.abs(slip(qpos, qvel)[2 * second :]).max() < 8  # while the turn sets in
    assert np.abs(slip(qpos, qvel)[4 * second :]).max() < 3
    ring = qpos[6 * second :, :2]  # one whole turn takes 4 s
    centre = (ring.max(axis=0) + ring.min(axis=0)) / 2
    radius = np.linalg.norm(ring - centre, axis=1)
    np.testing.assert_allclose(radius, 2 / QUARTER, rtol=0.03)  # ideal: 1.27 m
    assert np.sign(centre[1]) == side
    assert np.abs(qpos[:, 2] - HEIGHT).max() < 0.03


@pytest.mark.parametrize(("turn", "side"), [("left turn", 1), ("right turn", -1)])
def test_without_feed_forward_turns_slip_outwards(scene, flights_without_feed_forward, turn, side):
    qpos, qvel, _ = flights_without_feed_forward[turn]
    second = round(1 / scene.model.opt.timestep)
    steady = -side * slip(qpos, qvel)[5 * second :]
    # The survey has 30 degrees; a loop of gain k and yaw rate w settles at atan(w / k), 27.6.
    np.testing.assert_allclose(steady, np.degrees(np.arctan(QUARTER / 3)), atol=1.5)


def test_rotor_controls_keep_their_limits(scene, flights, flights_without_feed_forward):
    for flown in (flights, flights_without_feed_forward):
        for _, _, controls in flown.values():
            # Rounding may carry a control past its limit by a unit in the last place of 8 N.
            assert np.all(controls >= scene.vehicle.rotors.lower - 1e-6)
            assert np.all(controls <= scene.vehicle.rotors.upper + 1e-6)
    assert min(controls.min() for _, _, controls in flights.values()) < 1e-3  # a limit was met


def test_mixing_gives_the_thrust_and_torque_asked_for(scene):
    rng = np.random.default_rng(0)
    thrust = np.float32(rng.uniform(8, 24, 1000))
    torque = np.float32(rng.uniform(-1, 1, (1000, 3)) * (0.3, 0.3, 0.015))
    controls = np.stack(allocate_rotors(scene.vehicle, thrust, torque.T), axis=-1)
    made = controls @ scene.vehicle.rotors.wrench.T
    np.testing.assert_allclose(made, np.column_stack([thrust, torque]), atol=2e-5)


def test_yaw_gives_way_first(scene):
    rng = np.random.default_rng(1)
    thrust = np.float32(rng.uniform(8, 24, 1000))
    torque = np.float32(rng.uniform(-1, 1, (1000, 3)) * (0.3, 0.3, 0) + (0, 0, 1))
    torque[:500, 2] = -1
    controls = np.stack(allocate_rotors(scene.vehicle, thrust, torque.T), axis=-1)
    made = controls @ scene.vehicle.rotors.wrench.T
    np.testing.assert_allclose(made[:, :3], np.column_stack([thrust, torque[:, :2]]), atol=2e-5)
    assert np.all(np.sign(made[:, 3]) == torque[:, 2])
    assert np.all(np.abs(made[:, 3]) < 0.3)
    # It gives way no more than it must: some rotor stands at a limit.
    rotors = scene.vehicle.rotors
    room = np.minimum(controls - rotors.lower, rotors.upper - controls).min(axis=1)
    np.testing.assert_allclose(room, 0, atol=1e-5)


def test_mixing_keeps_the_limits_whatever_is_asked(scene):
    rng = np.random.default_rng(2)
    thrust, torque = np.float32(rng.normal(15, 30, 1000)), np.float32(rng.normal(0, 10, (1000, 3)))
    controls = np.stack(allocate_rotors(scene.vehicle, thrust, torque.T), axis=-1)
    assert np.all((controls >= -1e-5) & (controls <= 8 + 1e-5))


@pytest.mark.parametrize("which", ["six rooms", "other map"])
def test_the_closed_form_is_what_mjx_computes(which, other_map):
    with jax.enable_x64(True):
        path = None if which == "six rooms" else other_map
        vehicle, by_mjx = (pecjax.load_scene(path, by_mjx=by_mjx).vehicle for by_mjx in (False, True))
        assert vehicle.mjx is None and by_mjx.mjx is not None
        draw = np.random.default_rng(0)
        qpos, qvel, controls = (jnp.asarray(draw.normal(size=(50, n))) for n in (7, 6, 4))
        qpos = qpos.at[:, 3:].divide(jnp.linalg.norm(qpos[:, 3:], axis=1, keepdims=True))
        qvel = qvel.at[0].set(0.0).at[1].multiply(50.0)  # at rest, and tumbling
        air, payload = jnp.asarray(draw.normal(size=(50, 3))), jnp.asarray(draw.uniform(size=50))

        def fly(vehicle):
            def one(qpos, qvel, controls, air, payload):
                conditions = Conditions(air, (0.1, 0.2, 0.3), payload)
                return physics_step(vehicle, DroneState(qpos, qvel), controls, conditions)

            return jax.jit(jax.vmap(one))(qpos, qvel, controls, air, payload)

        for found, expected in zip(fly(vehicle), fly(by_mjx), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)


def test_a_drone_that_more_acts_on_is_left_to_mjx(tmp_path):
    for n, (old, new) in enumerate(AIR_AND_SPRING):
        assert old in OTHER_MAP
        (tmp_path / f"{n}.xml").write_text(OTHER_MAP.replace(old, new))
        assert pecjax.load_scene(tmp_path / f"{n}.xml").vehicle.mjx is not None


AIR_AND_SPRING = (
    ('timestep="0.01"/>', 'timestep="0.01" density="40" viscosity="0.3" wind="4 5 6" gravity="1 -2 -9"/>'),
    ("<freejoint/>", '<joint type="free" damping="0.2" stiffness="3" armature="0.01"/>'),
    ('<body name="drone" pos="-2 0 1"', '<body name="drone" gravcomp="0.5" pos="-1 0 1" euler="10 20 30"'),
)


@pytest.mark.parametrize("has_gravity", [True, False])
def test_all_that_acts_on_the_drone_in_its_map_acts_on_it_alone(has_gravity, tmp_path):
    text = OTHER_MAP
    for old, new in AIR_AND_SPRING:
        assert old in text
        text = text.replace(old, new)
    if not has_gravity:
        text = text.replace('-9"/>', '-9"><flag gravity="disable"/></option>')
    (tmp_path / "map.xml").write_text(text)
    scene = pecjax.load_scene(tmp_path / "map.xml")
    data = mujoco.MjData(scene.model)
    data.qpos[:], data.qvel[:] = (-2, 1, 1.5, 0.8, 0, 0.6, 0), (1, 2, 3, 0.4, -0.5, 0.6)
    state = DroneState(jnp.float32(data.qpos), jnp.float32(data.qvel))
    data.ctrl[:] = (1, 2, 3, 2.5)
    found = jax.jit(lambda *args: physics_step(scene.vehicle, *args))(state, jnp.float32(data.ctrl))
    mujoco.mj_step(scene.model, data)
    np.testing.assert_allclose(found.qvel, data.qvel, atol=2e-6)
    np.testing.assert_allclose(found.qpos, data.qpos, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("fillers", [0, FEW_WALLS])
def test_the_least_distance_of_a_flight_is_that_after_any_of_its_steps(scene, fillers):
    """Past a post that is nearest in between, among few walls and among many."""
    post = np.array([[1.0, 0.6, 0.0]]), np.array([[1.02, 0.7, 2.0]])
    far = np.full((fillers, 3), 50.0)
    walls = Walls(*(jnp.asarray(np.concatenate([corner, far]), jnp.float32) for corner in post))
    command, gains = Command(2.0, 0.0, HEIGHT), pecjax.ControllerGains()
    flight = jax.jit(
        lambda state, steps: fly(scene.vehicle, walls, gains, state, command, steps), static_argnums=1
    )
    state, distances = start(), []
    for _ in range(100):
        before, (state, distance) = state, flight(state, 1)
        distances.append((float(distance), before))
    nearest = int(np.argmin([distance for distance, _ in distances]))
    assert 2 < nearest < 97
    _, begin = distances[nearest - 2]
    _, least = flight(begin, 5)
    after = [distance for distance, _ in distances[nearest - 2 : nearest + 3]]
    np.testing.assert_allclose(least, min(after), rtol=1e-5)
    assert min(after) < min(after[0], after[-1]) - 1e-3


def test_halving_the_time_step_changes_little(scene, flights, edited_rooms):
    finer = [
        fly_all(pecjax.load_scene(edited_rooms(('timestep="0.02"', f'timestep="{dt}"'))))
        for dt in (0.01, 0.005)
    ]
    paths = [
        flown["varied"][0][stride - 1 : 3 * 50 * stride : stride, :3]
        for stride, flown in zip((1, 2, 4), (flights, *finer), strict=True)
    ]
    half, quarter = (np.abs(a - b).max() for a, b in pairwise(paths))
    assert half < 0.04  # of 3 m flown
    # Euler is of first order: each halving halves what is left.
    assert 1.6 < half / quarter < 2.5
