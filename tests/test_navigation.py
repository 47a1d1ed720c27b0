import brax.envs
import jax
import numpy as np
import pytest
from jax import numpy as jnp
from scipy import stats
from wrapped_flights import ends_of, evaluated, wrapped_flight

import pecjax
from pecjax.envs.axes import fill
from pecjax.envs.rooms.rotations import heading, quaternion_to_matrix

STAND, SPIN_LEFT, AHEAD, CIRCLE = 2, 4, 12, 9
ENDINGS = ("goal", "collision", "timeout")


def config(start, goal):
    return pecjax.Configurations(jnp.array(start, jnp.float32), jnp.array(goal, jnp.float32))


def begin(env, start, goal, looking=0.0):
    """As after `reset_to`, but looking where the test has it."""
    first = env.reset_to(config(start, goal), jax.random.key(0))
    there = env.task.place(first.pipeline_state.config, jnp.float32(looking))
    return first.replace(pipeline_state=there, obs=env.task.sense(jax.random.key(0), there, env.params))


def fly(step, state, actions):
    """The states after each action, to the end of the episode."""
    states = []
    for action in actions:
        state = step(state, jnp.int32(action))
        states.append(state)
        if state.done:
            break
    return states


def rewards(states):
    return [float(state.reward) for state in states]


def ending(state):
    return [name for name in ENDINGS if state.metrics[name]]


def signature(tree):
    return jax.tree.map(lambda x: (x.shape, x.dtype), tree)


@pytest.fixture(scope="module")
def fresh(env):
    return jax.jit(env.reset)(jax.random.PRNGKey(0))


def test_sizes_are_those_of_the_observation_and_the_actions(env, fresh):
    assert jax.tree.map(jnp.shape, fresh.obs) == env.observation_size == {"depth": (12, 16), "goal": (2,)}
    assert env.action_size == 15 and env.dt == 0.1
    assert isinstance(env, brax.envs.Env)


def test_a_step_keeps_structure_shapes_and_types(fresh, step):
    assert signature(fresh) == signature(step(fresh, jnp.int32(AHEAD)))


def test_a_second_step_compiles_nothing_new(env, fresh):
    # Weak types, which a dtype does not show, would compile the step twice.
    seen = []
    step = jax.jit(lambda state, action: seen.append(state) or env.step(state, action))
    jax.eval_shape(lambda s, a: step(step(s, a), a), fresh, jnp.int32(AHEAD))
    assert len(seen) == 1


@pytest.fixture(scope="module")
def fly_batch(env):
    """(states, actions (30, 15)) -> the states after them, in one program."""

    def scan(states, actions):
        return jax.lax.scan(lambda s, a: (jax.vmap(env.step)(s, a), None), states, actions)[0]

    return jax.jit(scan)


def test_vmap_and_scan_agree_with_single_steps(env, step, fly_batch):
    first = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(1), 15))
    actions = np.random.default_rng(0).integers(0, 15, (30, 15)).astype(np.int32)
    batch = fly_batch(first, actions)
    for n in range(4):
        state = jax.tree.map(lambda leaf, n=n: leaf[n], first)
        for action in actions[:, n]:
            state = step(state, action)
        same = jax.tree.map(lambda leaf, n=n: leaf[n], batch)
        # float32 in another order of operations, over 150 physics steps; a ray at an edge may switch walls.
        assert np.mean(np.abs(state.obs["depth"] - same.obs["depth"]) > 1e-3) < 0.03
        state, same = (s.replace(obs=s.obs["goal"]) for s in (state, same))
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-3), state, same)
        assert state.pipeline_state.step_count == 30


@pytest.mark.slow
def test_under_brax_the_default_task_ends_where_it_should_for_1500_steps(env):
    _, _, rows = wrapped_flight(env, STAND, steps=1500, episode_length=1000)
    assert ends_of(rows) == [[999]] * 4 and rows["timeout"].sum() == 4
    # Flown into a wall, it ends again and again after as many steps as the first time.
    _, _, rows = wrapped_flight(env, AHEAD, steps=1500, episode_length=1000)
    for n, ends in enumerate(ends_of(rows)):
        assert len(ends) > 10 and set(np.diff(ends)) == {ends[0] + 1}
        assert np.all((rows["collision"] + rows["goal"])[ends, n] == 1)
    # And under its evaluation, which counts each environment's first episode.
    _, last, rows = wrapped_flight(env, STAND, steps=1500, episode_length=1000, wrap=evaluated)
    assert ends_of(rows) == [[999]] * 4
    np.testing.assert_array_equal(last.info["eval_metrics"].episode_steps, np.full(4, 1000))


@pytest.mark.parametrize("key", [jax.random.PRNGKey, jax.random.key])
def test_untyped_and_typed_keys(env, key):
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(key(2), 4))
    assert state.obs["depth"].shape == (4, 12, 16)
    same = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(2), 4))
    jax.tree.map(np.testing.assert_array_equal, state, same)


def test_a_step_keeps_what_wrappers_have_put_there(env, fresh, step):
    state = fresh.replace(
        metrics=fresh.metrics | {"reward": jnp.float32(7)}, info={"truncation": jnp.float32(1)}
    )
    after = step(state, jnp.int32(AHEAD))
    assert signature(state) == signature(after)
    assert after.metrics["reward"] == 7 and after.info["truncation"] == 1


def test_physics_and_camera_ask_for_whole_float32_products(env, fresh):
    """GPUs would round the factors of a product to 11 bits, centimetres in the depth image."""
    text = str(jax.make_jaxpr(env.step)(fresh, jnp.int32(AHEAD)))
    products = text.count("dot_general[")
    assert products > 0 and text.count("Precision.HIGHEST") == 2 * products


def test_actions_are_speed_by_yaw_rate(env, fly_batch):
    """What every action has come to after 3 s; what it flies through on the way is of no matter."""
    first = jax.tree.map(lambda leaf: jnp.stack([leaf] * 15), begin(env, (0, -1.5), (5, 5)))
    drone = fly_batch(first, np.tile(np.arange(15, dtype=np.int32), (30, 1))).pipeline_state
    forward = np.linalg.norm(drone.qvel[:, :2], axis=1)
    np.testing.assert_allclose(forward, np.repeat([0, 1, 2], 5), atol=0.03)
    expected = np.tile(np.array([-2, -1, 0, 1, 2]) * np.pi / 4, 3)
    # The rates are the drone's own, and it leans into turns: what counts is the turn about the vertical.
    upright = jax.vmap(quaternion_to_matrix)(drone.qpos[:, 3:])[:, 2]
    np.testing.assert_allclose(jnp.sum(upright * drone.qvel[:, 3:], axis=1), expected, atol=0.03)
    # 12 goes straight along the heading, 2 stands still.
    np.testing.assert_allclose(drone.qpos[AHEAD, 1], -1.5, atol=1e-3)
    np.testing.assert_allclose(drone.qpos[STAND, :3], (0, -1.5, 1.2), atol=1e-3)


def test_reaching_the_goal_pays_2000_once(env, step):
    states = fly(step, begin(env, (0, -2), (5, -2)), [AHEAD] * 60)
    assert rewards(states) == [-1.0] * (len(states) - 1) + [1999.0]
    assert ending(states[-1]) == ["goal"] and states[-1].done == 1
    distances = [float(s.obs["goal"][0]) for s in states]
    assert distances[-1] < 0.5 <= distances[-2]
    assert 22 < len(states) < 32  # 4.5 m at 2 m/s, and half a second to gather speed


def test_hitting_a_wall_costs_1000_once(env, step):
    states = fly(step, begin(env, (5, -2), (0, -2)), [AHEAD] * 60)
    assert rewards(states) == [-1.0] * (len(states) - 1) + [-1001.0]
    assert ending(states[-1]) == ["collision"] and states[-1].done == 1
    along = [float(s.pipeline_state.qpos[0]) for s in states]
    # The wall's face is at 7.9 and the drone's radius 0.25.
    assert along[-2] < 7.65 <= along[-1]


def test_a_collision_counts_even_at_the_goal(env, step):
    # The goal's circle reaches the wall: at 2 m/s the drone enters it before it hits.
    states = fly(step, begin(env, (5, -2), (7.9, -2)), [AHEAD] * 60)
    assert ending(states[-1]) == ["goal"]
    # Where both happen in the same step the collision counts, and alone.
    touching = begin(env, (7.7, -2), (7.6, -2))
    state = step(touching, jnp.int32(STAND))
    assert ending(state) == ["collision"] and state.reward == -1001


def test_the_thousandth_step_ends_the_episode(env, step):
    # Round and round on a circle of 0.64 m, so that standing costs nothing.
    states = fly(step, begin(env, (0, -2), (5, 5)), [CIRCLE] * 1001)
    assert len(states) == 1000
    assert rewards(states) == [-1.0] * 999 + [-1001.0]
    assert ending(states[-1]) == ["timeout"] and states[-1].done == 1


def test_the_step_limit_is_a_setting_and_the_goal_takes_precedence(scene):
    quick = pecjax.RoomsNavigation(scene, settings=pecjax.NavigationSettings(max_steps=3))
    step = jax.jit(quick.step)
    assert rewards(fly(step, begin(quick, (0, -2), (5, -2)), [AHEAD] * 5)) == [-1, -1, -1001]
    first = begin(quick, (0, -2), (0.52, -2))
    assert rewards(fly(step, first, [STAND] * 2)) == [-1, -1]
    states = fly(step, first, [AHEAD] * 3)
    assert ending(states[-1]) == ["goal"] and not states[-1].metrics["timeout"]


@pytest.mark.parametrize("standing", [STAND, SPIN_LEFT])
def test_standing_costs_3_more_from_the_eleventh_action_in_a_row(env, step, standing):
    first = begin(env, (0, -2), (5, 5))
    flight = [standing] * 13 + [CIRCLE] + [standing] * 11
    expected = [-1] * 10 + [-4] * 3 + [-1] + [-1] * 10 + [-4]
    assert rewards(fly(step, first, flight)) == expected


@pytest.mark.parametrize(
    ("start", "goal", "looking", "bearing"),
    [
        ((0, -2), (5, -2), 0.0, 0.0),
        ((0, -2), (0, 0), 0.0, np.pi / 2),  # on the left
        ((0, -2), (0, -3), 0.0, -np.pi / 2),  # on the right
        ((0, -2), (5, -2), 0.3, -0.3),
        ((0, -2), (-3, -2.1), -3.0, 3 - np.pi + np.arctan(0.1 / 3)),  # across the seam of the angle
        ((0, -2), (-3, -1.9), 3.0, np.pi - 3 - np.arctan(0.1 / 3)),
    ],
)
def test_distance_and_bearing_of_the_goal(env, start, goal, looking, bearing):
    seen = begin(env, start, goal, looking).obs["goal"]
    np.testing.assert_allclose(seen, (np.linalg.norm(np.subtract(goal, start)), bearing), atol=1e-5)


def test_bearings_stay_within_half_a_turn(env):
    looking = np.linspace(-np.pi, np.pi, 721, dtype=np.float32)
    there = fill(config((0, -2), (-3, -2)))
    key = jax.random.key(0)
    sense = jax.jit(jax.vmap(lambda h: env.task.sense(key, env.task.place(there, h), env.params)["goal"][1]))
    bearing = np.asarray(sense(looking))
    assert np.all(np.abs(bearing) <= np.float32(np.pi))
    np.testing.assert_allclose(np.exp(1j * bearing), np.exp(1j * (np.pi - looking)), atol=1e-5)


def test_turning_left_takes_the_goal_to_the_right(env, step):
    states = fly(step, begin(env, (0, -2), (5, -2)), [SPIN_LEFT] * 5)
    bearings = [float(s.obs["goal"][1]) for s in states]
    assert np.all(np.diff(bearings) < 0) and bearings[-1] < -0.4


def test_what_a_critic_is_told_of_the_drone_by_hand(env):
    """Flying to the north at 2 m/s while it slips 1 m/s to the west, looking north."""
    state = begin(env, (3, -2), (0, 0), np.pi / 2).pipeline_state
    qvel = jnp.float32([-1, 2, 0.5, 0, 0, 0.25])
    state = state._replace(qvel=qvel, qpos=state.qpos.at[2].set(1.3), step_count=500, hover_count=5)
    found = env.task.privileged(state, env.params)["drone"]
    np.testing.assert_allclose(found, [0.3, -0.2, 0, 1, 1, 0.5, 0.5, 0.25, 0.1, 0.5, 0.5], atol=1e-6)
    assert env.task.privileged(state._replace(hover_count=900), env.params)["drone"][-1] == 2


def test_reset_draws_every_row_and_every_heading_alike(env):
    keys = jax.random.split(jax.random.PRNGKey(3), 4000)
    state = jax.jit(jax.vmap(env.reset))(keys)
    table = pecjax.COORDINATE_SET_1
    starts, goals = (getattr(state.pipeline_state.config, name) for name in ("start", "goal"))
    row = np.argmax(
        np.all(starts[:, None] == table.start, axis=-1) & np.all(goals[:, None] == table.goal, axis=-1),
        axis=1,
    )
    np.testing.assert_array_equal(table.goal[row], goals)
    assert stats.chisquare(np.bincount(row, minlength=20)).pvalue > 1e-3
    looking = np.asarray(jax.vmap(heading)(state.pipeline_state.qpos[:, 3:]))
    assert stats.kstest(looking, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
    # Headings say nothing about rows.
    octant = np.digitize(looking, np.linspace(-np.pi, np.pi, 9)[1:-1])
    together = np.histogram2d(row, octant, bins=(20, 8))[0]
    assert stats.chi2_contingency(together).pvalue > 1e-3
    np.testing.assert_array_equal(state.pipeline_state.qpos[:, :2], starts)
    np.testing.assert_allclose(state.pipeline_state.qpos[:, 2], 1.2)
    assert not np.any(state.pipeline_state.qvel)


def test_reset_to_starts_in_the_configuration_given(env):
    row = jax.tree.map(lambda leaf: jnp.asarray(leaf)[7], pecjax.COORDINATE_SET_2)
    state = env.reset_to(row, jax.random.PRNGKey(0))
    np.testing.assert_array_equal(state.pipeline_state.qpos[:2], (5, -2))
    np.testing.assert_array_equal(state.pipeline_state.config.goal, (0, 5))
    assert state.done == 0 and state.pipeline_state.step_count == 0


def test_control_period_must_be_a_multiple_of_the_physics_step(scene):
    with pytest.raises(pecjax.InputError, match=r"0\.05 s is not a multiple"):
        pecjax.RoomsNavigation(scene, settings=pecjax.NavigationSettings(control_period=0.05))


@pytest.fixture(scope="module")
def step_all(env):
    """`env.step` of several environments, compiled once."""
    return jax.jit(jax.vmap(env.step))


@pytest.mark.parametrize("speed", [np.nan, np.inf, 1e12])
def test_physics_that_blows_up_is_a_collision_and_stays_where_it_was(speed, env, step_all):
    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(3), 3))
    broken = state.pipeline_state.qvel.at[1, 0].set(speed)
    spoilt = state.replace(pipeline_state=state.pipeline_state._replace(qvel=broken))
    after, alone = (step_all(s, jnp.full(3, 12)) for s in (spoilt, state))
    assert after.done[1] == after.metrics["collision"][1] == after.metrics["unstable"][1] == 1
    assert after.reward[1] == -1001 and np.isfinite(after.obs["depth"]).all()
    np.testing.assert_array_equal(after.pipeline_state.qpos[1], state.pipeline_state.qpos[1])
    # The others know nothing of it.
    for row in (0, 2):
        assert after.metrics["unstable"][row] == 0
        jax.tree.map(lambda a, b, k=row: np.testing.assert_array_equal(a[k], b[k]), after, alone)
