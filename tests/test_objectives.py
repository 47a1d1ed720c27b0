"""Objectives: reach, hold, via: when they are met, what they are shown as, what is refused."""

import jax
import numpy as np
import pytest
from contract_task import check_task
from jax import numpy as jnp

import pecjax
from pecjax.envs.axes import make_table
from pecjax.envs.rooms.config import HOLD, REACH, VIA
from pecjax.envs.rooms.maps import make_bank
from pecjax.envs.rooms.objectives import advance
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.task import STAND_STILL, RoomsParams, RoomsTask
from pecjax.envs.task import World, take_configs

AHEAD, LEFT = 12, 14
HOLD_STEPS = 20


@pytest.fixture(scope="module")
def task(scene):
    return RoomsTask(scene.vehicle, objectives=True)


@pytest.fixture(scope="module")
def params(scene):
    return RoomsParams(make_bank([scene.map]))


def row(objective, start=(0, -2), goal=(3, -2), waypoint=(0, 0)):
    table = make_table(
        pecjax.Configurations,
        start=np.array([start]),
        goal=np.array([goal]),
        heading=np.zeros(1),
        objective=np.array([objective]),
        waypoint=np.array([waypoint]),
    )
    return take_configs(table, 0)


@pytest.fixture(scope="module")
def fly(gliding, task, params):
    """(row, actions) -> transitions after each action, and what is observed after each."""

    @jax.jit
    def fly(config, actions):
        def step(state, action):
            after = task.step(jax.random.key(0), state, action, params)
            return after.state, (after, task.sense(jax.random.key(0), after.state, params))

        return jax.lax.scan(step, task.reset(jax.random.key(0), config, params), actions)[1]

    return lambda config, actions: jax.device_get(fly(config, jnp.asarray(actions)))


def first(flags):
    return int(np.argmax(flags)) if flags.any() else None


def test_reach_is_met_at_the_first_step_within_the_radius(fly):
    flown, _ = fly(row(REACH), [AHEAD] * 15)
    distance = np.linalg.norm(flown.state.qpos[:, :2] - [3, -2], axis=1)
    assert first(flown.success) == first(distance < 0.5)


def test_hold_is_met_after_two_seconds_within_the_radius_and_not_before(fly):
    """As many steps without success as the time has, counted by the distances alone."""
    flown, _ = fly(row(HOLD), [AHEAD] * 14 + [STAND_STILL] * 40)
    near = np.linalg.norm(flown.state.qpos[:, :2] - [3, -2], axis=1) < 0.5
    assert near[first(near) :].all()
    assert first(flown.success) == first(near) + HOLD_STEPS
    assert flown.reward[first(flown.success)] == 2000 - 1
    assert (flown.reward[: first(flown.success)] == -1).all()  # standing there is no idling


def test_leaving_the_radius_begins_anew(fly):
    through = [AHEAD] * 30  # flies through the goal's radius, 1 m wide, within six steps
    flown, _ = fly(row(HOLD), through)
    near = np.linalg.norm(flown.state.qpos[:, :2] - [3, -2], axis=1) < 0.5
    assert 2 <= near.sum() <= 6 and not flown.success.any()
    assert flown.state.progress[-1] == 0


def test_idling_elsewhere_is_penalized_under_hold_too(fly):
    flown, _ = fly(row(HOLD), [STAND_STILL] * 12)
    assert flown.reward[9] == -1 and flown.reward[10] == flown.reward[11] == -4


def test_via_leads_to_the_waypoint_first(fly):
    """The goal lies on the way to the waypoint: passing it first counts for nothing."""
    config = row(VIA, goal=(1.5, -2), waypoint=(4, -2))
    turn_back = [AHEAD] * 18 + [LEFT - 10] * 20 + [AHEAD] * 25
    flown, seen = fly(config, turn_back)
    x = flown.state.qpos[:, 0]
    passed = first(np.abs(x - 4) < 0.5)
    assert (np.abs(x[:passed] - 1.5) < 0.5).any(), "it flew past the goal before"
    assert not flown.success[: passed + 1].any() and flown.success.any()
    assert flown.state.progress[passed] == 1 and flown.state.progress[passed - 1] == 0
    target = np.where(np.arange(len(x))[:, None] < passed, [4, -2], [1.5, -2])
    distance = np.linalg.norm(flown.state.qpos[:, :2] - target, axis=1)
    np.testing.assert_allclose(seen["goal"][:, 0], distance, atol=1e-4)


def test_one_place_as_waypoint_and_goal_takes_two_steps(fly):
    flown, _ = fly(row(VIA, goal=(3, -2), waypoint=(3, -2)), [AHEAD] * 16)
    reached, _ = fly(row(REACH), [AHEAD] * 16)
    assert first(flown.success) == first(reached.success) + 1


def test_a_collision_meets_nothing(fly):
    flown, _ = fly(row(VIA, goal=(0, 0.8), waypoint=(0, -2)), [LEFT - 10] * 10 + [AHEAD] * 20)
    assert flown.metrics["collision"].any()
    assert not (flown.success & flown.metrics["collision"]).any()


def test_a_policy_is_shown_the_objectives_that_it_was_trained_with(scene, task):
    plain = RoomsTask(scene.vehicle)
    table = pecjax.COORDINATE_SET_1
    assert plain.fitted(table) is table
    reach = task.fitted(table)
    assert np.all(reach.objective == REACH) and plain.fitted(reach).objective is None
    with pytest.raises(pecjax.InputError, match="objectives, which this policy was never shown"):
        plain.fitted(reach.replace(objective=np.full(20, HOLD)))


@pytest.mark.parametrize("seed", range(3))
def test_progress_is_that_of_the_words_themselves(seed):
    """Against a transcription that keeps the whole history, over random approaches."""
    near = np.random.default_rng(seed).random(400) < 0.8
    for objective in (REACH, HOLD, VIA):
        config, progress, passed = row(objective), jnp.int32(0), False
        step = jax.jit(lambda progress, near, config=config: advance(config, progress, near, 5))
        for n in range(len(near)):
            progress, met = step(progress, near[n])
            since = n - max((k for k in range(n + 1) if not near[k]), default=-1) - 1
            expected = {REACH: near[n], HOLD: near[n] and since >= 5, VIA: near[n] and passed}[objective]
            assert bool(met) == expected, (objective, n)
            passed |= near[n]


def test_the_contract_holds_and_the_objective_is_seen(task, params, gliding):
    table = make_table(
        pecjax.Configurations,
        start=np.array([[0, -2]] * 3),
        goal=np.array([[5, -2]] * 3),
        objective=np.arange(3),
        waypoint=np.array([[3, -2]] * 3),
    )
    check_task(task, World(params, table), steps=30)
    for objective in range(3):
        state = task.reset(jax.random.key(0), take_configs(table, objective), params)
        np.testing.assert_array_equal(
            task.observe(jax.random.key(0), state, params)["objective"], np.eye(3)[objective]
        )


def test_without_the_axis_nothing_is_there(scene, params):
    task = RoomsTask(scene.vehicle)
    state = task.reset(jax.random.key(0), take_configs(pecjax.COORDINATE_SET_1, 0), params)
    assert state.progress is None and set(task.observation_space) == {"depth", "goal"}
    assert set(task.observe(jax.random.key(0), state, params)) == {"depth", "goal"}


def test_under_brax_the_objective_is_part_of_the_observation(scene):
    table = make_table(
        pecjax.Configurations, start=np.array([[0, -2]]), goal=np.array([[5, -2]]), objective=np.array([HOLD])
    )
    env = pecjax.RoomsNavigation(scene, table)
    state = jax.jit(env.reset)(jax.random.key(0))
    assert {name: value.shape for name, value in state.obs.items()} == env.observation_size
    np.testing.assert_array_equal(state.obs["objective"], [0, 1, 0])


@pytest.mark.parametrize(
    ("header", "line", "said"),
    [
        ("objective", "2", "leads to a waypoint; add columns waypoint_x, waypoint_y"),
        ("waypoint_x,waypoint_y", "1,1", "waypoints without objectives; add a column objective"),
        ("objective,waypoint_x,waypoint_y", "2,-3,4", "waypoint .* inside a wall"),
        ("objective,waypoint_x,waypoint_y", "2,50,4", "waypoint .* lies outside the map"),
        ("objective", "3", "objective is 3; it must be a whole number from 0 to 2"),
    ],
)
def test_what_cannot_be_gets_one_line(tmp_path, header, line, said):
    file = tmp_path / "tasks.csv"
    file.write_text(f"start_x,start_y,goal_x,goal_y,{header}\n0,-2,5,-2,{line}\n")
    with pytest.raises(pecjax.InputError, match=said):
        pecjax.Rooms(table=str(file)).make()


def test_a_waypoint_that_no_path_leads_to_is_refused(edited_rooms, tmp_path):
    """The hall's door to the north-east is closed: the waypoint lies behind it, the goal does not."""
    closed = edited_rooms(
        (
            'name="north_b" pos="-3 1 1.25" size="1.3 0.1 1.25"',
            'name="north_b" pos="-2 1 1.25" size="2.3 0.1 1.25"',
        )
    )
    file = tmp_path / "tasks.csv"
    file.write_text("start_x,start_y,goal_x,goal_y,objective,waypoint_x,waypoint_y\n0,-2,5,-2,2,3,5\n")
    with pytest.raises(pecjax.InputError, match=r"no path .* from \(0, -2\) to \(3, 5\)"):
        pecjax.Rooms(table=str(file), maps=(str(closed),)).make()
    file.write_text(file.read_text().replace(",2,3,5", ",0,3,5"))
    pecjax.Rooms(table=str(file), maps=(str(closed),)).make()  # no objective leads there


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan")])
def test_a_goal_is_held_for_some_time(scene, wrong):
    with pytest.raises(pecjax.InputError, match=r"hold-time is .*; give more than 0"):
        RoomsTask(scene.vehicle, NavigationSettings(hold_time=wrong))
