"""Wind, gusts, payload, weak motors and late actions: against C MuJoCo and against closed forms."""

import jax
import mujoco
import numpy as np
import pytest
from jax import numpy as jnp
from scipy import stats
from test_flight import replay

import pecjax
from pecjax.envs.rooms.air import drag_force, first_gust, next_gust
from pecjax.envs.rooms.controller import Command
from pecjax.envs.rooms.flight import Conditions, hover, physics_step, rotor_controls
from pecjax.envs.rooms.rotations import quaternion_to_matrix

DRAG = pecjax.NavigationSettings().drag
WIND = np.array([3.0, -2.0, 0.5])
AHEAD = 12


@pytest.fixture(scope="module", autouse=True)
def in_64_bits():
    with jax.enable_x64(True):
        yield


def fly_on(vehicle, conditions, steps=300):
    """qpos, qvel and controls of a varied flight after each physics step."""

    def step(state, time):
        command = Command(1 + jnp.sin(time / 40), jnp.cos(time / 60), 1.2)
        controls = rotor_controls(vehicle, pecjax.ControllerGains(), state, command)
        state = physics_step(vehicle, state, controls, conditions)
        return state, (*state, controls)

    first = hover(jnp.array([0, 0, 1.2]), jnp.zeros(()))
    return [np.asarray(x) for x in jax.jit(lambda: jax.lax.scan(step, first, jnp.arange(steps)))()[1]]


def in_wind(qpos, qvel):
    """hector_quadrotor's drag, transcribed."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, qpos[3:])
    rotation = rotation.reshape(3, 3)
    u = rotation.T @ (qvel[:3] - WIND)
    return rotation @ (-np.array([0.12, 0.12, 0.1]) * np.linalg.norm(u) * u)


def assert_same(flown, expected):
    qpos, qvel, _ = flown
    assert np.linalg.norm(np.diff(qpos[:, :3], axis=0), axis=1).sum() > 3  # a flight worth the name
    np.testing.assert_allclose(qpos, expected[0], atol=1e-9)
    np.testing.assert_allclose(qvel, expected[1], atol=1e-9)


@pytest.fixture(scope="module")
def scene(in_64_bits):
    return pecjax.load_scene()


@pytest.fixture(scope="module")
def first():
    return hover(jnp.array([0, 0, 1.2]), jnp.zeros(()))


def test_wind_is_that_of_c_mujoco_under_the_same_force(scene, first):
    flown = fly_on(scene.vehicle, Conditions(air=jnp.asarray(WIND), drag=DRAG))
    assert_same(flown, replay(scene.model, flown[2], first, in_wind))
    without = fly_on(scene.vehicle, Conditions())
    assert np.abs(flown[0][:, :3] - without[0][:, :3]).max() > 0.3  # and it matters


def test_a_payload_is_that_of_c_mujoco_with_a_heavier_body(first):
    scene = pecjax.load_scene()  # its own, to be made heavier
    vehicle, drone = scene.vehicle, scene.model.body("drone").id
    flown = fly_on(vehicle, Conditions(payload=jnp.asarray(0.4)))
    growth = 1 + 0.4 / scene.model.body_mass[drone]
    scene.model.body_mass[drone] *= growth
    scene.model.body_inertia[drone] *= growth
    mujoco.mj_setConst(scene.model, mujoco.MjData(scene.model))
    assert_same(flown, replay(scene.model, flown[2], first))
    # The controller does not know: it settles where its climb command makes up for the weight.
    hanging = fly_on(vehicle, Conditions(payload=jnp.asarray(0.4)), steps=1500)[0][-1, 2]
    gains = pecjax.ControllerGains()
    sag = 0.4 / vehicle.mass * vehicle.gravity / (gains.climb * gains.height)
    assert hanging == pytest.approx(1.2 - sag, abs=0.05)


def test_weak_motors_are_those_of_c_mujoco_under_weaker_controls(scene, first):
    flown = fly_on(scene.vehicle, Conditions(motor_strength=jnp.asarray(0.8)))
    assert_same(flown, replay(scene.model, 0.8 * flown[2], first))


def test_an_uncontrolled_drone_comes_to_drift_with_the_wind(scene, first):
    """Its level speed becomes the wind's, and it falls as fast as drag in z carries its weight."""
    state, vehicle = first, scene.vehicle
    none = jnp.zeros(vehicle.rotors.lower.shape)
    wind = jnp.array([3.0, -2.0, 0.0])
    step = jax.jit(lambda state: physics_step(vehicle, state, none, Conditions(wind, DRAG)))
    for _ in range(3000):
        state = step(state)
    terminal = np.sqrt(vehicle.mass * vehicle.gravity / DRAG[2])
    np.testing.assert_allclose(state.qvel, [3, -2, -terminal, 0, 0, 0], atol=1e-4)


def test_drag_slows_as_the_closed_form_says(scene, first):
    """m dv/dt = -c v² has v = v0 / (1 + c v0 t / m); the drone hovers while it drifts."""
    vehicle, speed = scene.vehicle, 4.0
    state = first._replace(qvel=first.qvel.at[0].set(speed))
    weight = jnp.linalg.pinv(jnp.asarray(vehicle.rotors.wrench)) @ jnp.array(
        [vehicle.mass * vehicle.gravity, 0, 0, 0]
    )
    step = jax.jit(lambda state: physics_step(vehicle, state, weight, Conditions(jnp.zeros(3), DRAG)))
    steps = round(2 / vehicle.timestep)
    for _ in range(steps):
        state = step(state)
    expected = speed / (1 + DRAG[0] * speed * steps * vehicle.timestep / vehicle.mass)
    assert state.qvel[0] == pytest.approx(expected, rel=5e-3)  # Euler's error at this step
    assert state.qpos[2] == pytest.approx(1.2, abs=1e-6)


def test_drag_turns_with_the_drone():
    upside = quaternion_to_matrix(jnp.array([0.0, 1.0, 0.0, 0.0]))
    on_its_side = quaternion_to_matrix(jnp.array([1.0, 0.0, 1.0, 0.0]) / np.sqrt(2))  # x down, z ahead
    still, ahead = jnp.zeros(3), jnp.array([2.0, 0, 0])
    np.testing.assert_allclose(drag_force((1, 2, 3), still, upside, ahead), [-4, 0, 0], atol=1e-12)
    np.testing.assert_allclose(drag_force((1, 2, 3), still, on_its_side, ahead), [-12, 0, 0], atol=1e-12)


def test_gusts_are_an_ornstein_uhlenbeck_process():
    """Mean, deviation and correlation in time, whatever the period."""
    period, time, deviation = 0.1, 0.5, 2.0

    def step(gust, key):
        gust = next_gust(key, gust, deviation, period, time)
        return gust, gust

    keys = jax.random.split(jax.random.key(1), 2000)
    starts = jax.vmap(lambda key: first_gust(key, jnp.asarray(deviation)))(keys)
    run = jax.vmap(lambda gust, key: jax.lax.scan(step, gust, jax.random.split(key, 20))[1])
    gusts = np.asarray(jax.jit(run)(starts, keys))
    assert stats.kstest(gusts[:, 0].ravel() / deviation, "norm").pvalue > 1e-3
    assert stats.kstest(gusts[:, -1].ravel() / deviation, "norm").pvalue > 1e-3
    for lag in (1, 5):
        found = np.corrcoef(gusts[:, 0].ravel(), gusts[:, lag].ravel())[0, 1]
        assert found == pytest.approx(np.exp(-lag * period / time), abs=0.04)
    assert abs(np.corrcoef(gusts[:, 0].T)[0, 1]) < 0.08  # the components are on their own
