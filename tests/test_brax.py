"""Brax's wrappers around the environment: episodes end where they should, however long it goes on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from wrapped_flights import ends_of, evaluated, wrapped_flight

import pecjax

STAND = 2


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


def test_under_brax_an_episode_ends_at_its_own_limit_every_time(scene):
    short = pecjax.RoomsNavigation(scene, settings=pecjax.NavigationSettings(max_steps=20))
    first, last, rows = wrapped_flight(short, STAND, steps=405, episode_length=1000)
    assert ends_of(rows) == [list(range(19, 405, 20))] * 4
    np.testing.assert_array_equal(rows["timeout"], rows["done"])
    assert not rows["truncation"].any()
    np.testing.assert_array_equal(rows["counted"][:, 0], (1 + np.arange(405)) % 20)
    # Brax resets to what the environment began with.
    jax.tree.map(np.testing.assert_array_equal, last.pipeline_state.config, first.pipeline_state.config)
    assert jax.tree.map(jnp.shape, first.pipeline_state) == jax.tree.map(jnp.shape, last.pipeline_state)


def test_under_brax_a_shorter_episode_length_truncates(scene):
    short = pecjax.RoomsNavigation(scene, settings=pecjax.NavigationSettings(max_steps=20))
    _, _, rows = wrapped_flight(short, STAND, steps=305, episode_length=7)
    assert ends_of(rows) == [list(range(6, 305, 7))] * 4
    np.testing.assert_array_equal(rows["truncation"], rows["done"])
    assert not rows["timeout"].any()


def test_brax_can_evaluate_it(scene):
    short = pecjax.RoomsNavigation(scene, settings=pecjax.NavigationSettings(max_steps=20))
    _, last, rows = wrapped_flight(short, STAND, steps=50, episode_length=1000, wrap=evaluated)
    assert ends_of(rows) == [[19, 39]] * 4
    found = last.info["eval_metrics"]
    # Standing costs 3 more from the eleventh step on, and the limit 1,000: of the first episode.
    np.testing.assert_allclose(found.episode_metrics["reward"], np.full(4, -20 - 10 * 3 - 1000))
    np.testing.assert_array_equal(found.episode_metrics["timeout"], np.ones(4))
    np.testing.assert_array_equal(found.episode_steps, np.full(4, 20))
    np.testing.assert_array_equal(found.active_episodes, np.zeros(4))


def test_under_brax_what_the_camera_misses_is_drawn_anew_at_every_step(scene):
    dropping = pecjax.COORDINATE_SET_1.replace(depth_dropout=np.full(20, 0.5, np.float32))
    env = pecjax.RoomsNavigation(scene, dropping, pecjax.NavigationSettings(max_steps=20))
    state, far = env.reset(jax.random.key(0)), scene.vehicle.camera.far
    missed = []
    for _ in range(4):
        state = env.step(state, jnp.int32(STAND))
        missed.append(np.asarray(state.obs["depth"] == far))
    assert all((one != other).any() for n, one in enumerate(missed) for other in missed[:n])
    assert 0.4 < np.mean(missed) < 0.75  # half of the pixels, and those that see as far
    first, last, rows = wrapped_flight(env, STAND, steps=50, episode_length=1000)
    assert ends_of(rows) == [[19, 39]] * 4
    assert (first.info["key"] != last.info["key"]).any(axis=-1).all()
