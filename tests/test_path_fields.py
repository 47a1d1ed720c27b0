"""Path fields: what critics are told of the way, by hand, beside geodesics, and that no policy sees it."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pecjax.agents import PPO
from pecjax.envs.rooms import Rooms
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.geodesics import geodesic_lengths
from pecjax.envs.rooms.maps import FAR_AWAY, MapBank
from pecjax.envs.rooms.path_fields import CELL, make_path_fields, path_from
from pecjax.envs.rooms.sensing import DISTANCE_SCALE
from pecjax.envs.spaces import Box
from pecjax.errors import InputError
from pecjax.training.build import build
from pecjax.training.contracts import check_task
from pecjax.training.settings import EvaluationSettings, RunSettings, StopSettings
from pecjax.training.train import train

FILE = Path(__file__).parents[1] / "benchmarks" / "bounds.py"
SPEC = importlib.util.spec_from_file_location("bounds", FILE)
bounds = importlib.util.module_from_spec(SPEC)
sys.modules["bounds"] = bounds  # where its dataclasses look for their module
SPEC.loader.exec_module(bounds)

ROOM = np.float32([(0, 0), (10, 8)])
WALL = np.float32([(4.9, 0, 0)]), np.float32([(5.1, 6, 3)])  # the way past it is at y of 6 to 8
NOTHING = np.full((1, 3), FAR_AWAY, np.float32)
GOAL, OTHER = np.float32([9, 1]), np.float32([1, 7])
TO_THE_GAP, ON_FROM_IT = np.float64([2, 5.5]), np.float64([4, 5.5])  # from (3, 1)


@pytest.fixture(scope="module")
def fields():
    """Of an empty room with two goals, and of one with a wall, a goal and a waypoint."""
    bank = MapBank(np.stack([NOTHING, WALL[0]]), np.stack([NOTHING, WALL[1]]), np.stack([ROOM, ROOM]))
    goal = np.stack([GOAL, OTHER, GOAL])
    table = Configurations(
        start=goal,
        goal=goal,
        map_id=np.int32([0, 0, 1]),
        objective=np.int32([0, 0, 2]),
        waypoint=np.float32([(7, 7), (7, 7), (2, 7)]),
    )
    return make_path_fields(bank, [table, table], radius=0.2, flight_height=1.2)


def told(fields, map_id, goal, place, heading=0.0):
    """Length m, and direction rad off the heading."""
    length, sine, cosine = path_from(
        fields, jnp.int32(map_id), jnp.float32(goal), jnp.float32(place), heading
    )
    return float(length) * DISTANCE_SCALE, float(np.arctan2(sine, cosine))


def turned(angle):
    return abs((angle + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("goal", [GOAL, OTHER])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_in_the_open_the_way_is_straight(fields, goal, heading):
    for place in ((1.2, 2), (3, 5), (8.6, 7)):
        offset = goal - place
        length, turn = told(fields, 0, goal, place, heading)
        assert turned(turn + heading - np.arctan2(offset[1], offset[0])) < 0.25  # paths go from cell to cell
        np.testing.assert_allclose(length, np.linalg.norm(offset), rtol=0.1, atol=0.3)


def test_behind_a_wall_it_leads_around_it(fields):
    length, turn = told(fields, 1, GOAL, (3, 1))
    assert turned(turn - np.arctan2(TO_THE_GAP[1], TO_THE_GAP[0])) < 0.4
    np.testing.assert_allclose(length, np.linalg.norm(TO_THE_GAP) + np.linalg.norm(ON_FROM_IT), rtol=0.1)
    _, past = told(fields, 1, GOAL, (6, 6.5))
    assert past < -0.8  # and down to the goal


def test_a_waypoint_is_a_goal_where_one_leads_by_it(fields):
    assert set(fields.field[1].ravel()) == set(fields.field[0].ravel()) == {0, 1}
    assert told(fields, 0, OTHER, OTHER)[0] == told(fields, 1, (2, 7), (2, 7))[0] == 0
    length, turn = told(fields, 1, (2, 7), (2, 3))
    np.testing.assert_allclose(length, 4, atol=0.3)
    np.testing.assert_allclose(turn, np.pi / 2, atol=0.1)


def test_where_no_path_leads_it_is_far_and_straight_ahead():
    across = np.float32([(4.9, 0, 0)]), np.float32([(5.1, 8, 3)])
    table = Configurations(start=GOAL[None], goal=GOAL[None], map_id=np.int32([0]))
    bank = MapBank(across[0][None], across[1][None], ROOM[None])
    closed = make_path_fields(bank, [table], radius=0.2, flight_height=1.2)
    length, turn = told(closed, 0, GOAL, (3, 4))
    assert length == pytest.approx(255 * 0.25)
    np.testing.assert_allclose(turn, np.arctan2(-3, 6), atol=0.02)
    assert told(closed, 0, GOAL, (6, 4))[0] < 5
    full = MapBank(np.float32([[(-1, -1, 0)]]), np.float32([[(11, 9, 3)]]), ROOM[None])
    full = make_path_fields(full, [table], radius=0.2, flight_height=1.2)
    assert np.all(full.length == 255) and np.all(full.bearing == 0)


@pytest.fixture(scope="module")
def paper():
    settings = Rooms(table="2", critic_paths=True)
    task, world = settings.make()
    return settings, task, settings.for_training(world)


def test_maps_without_a_goal_have_none(fields):
    """Such as those that a space holds out."""
    bank = MapBank(*(np.stack([part, part]) for part in (*WALL, ROOM)))
    table = Configurations(start=GOAL[None], goal=GOAL[None], map_id=np.int32([1]))
    found = make_path_fields(bank, [table], radius=0.2, flight_height=1.2)
    assert np.all(found.length[0] == 255)
    np.testing.assert_array_equal(found.length[1, 0], fields.length[1, 1])


def test_lengths_are_those_of_geodesics(paper):
    """On a grid of half the cell, by the search for single paths."""
    settings, task, world = paper
    table, walls = world.table, settings.scenes()[0].map
    wanted = geodesic_lengths(
        walls.lower, walls.upper, walls.bounds, table.start, table.goal, radius=task.vehicle.radius,
        flight_height=settings.flight_height,
    )  # fmt: skip
    found = [
        told(world.params.paths, 0, goal, start)[0]
        for start, goal in zip(table.start, table.goal, strict=True)
    ]
    np.testing.assert_allclose(found, wanted, rtol=0.05, atol=0.4)


def test_who_follows_it_comes_to_the_goal(paper):
    _, _, world = paper
    for start, goal in zip(world.table.start, world.table.goal, strict=True):
        place = np.array(start)
        length = left = told(world.params.paths, 0, goal, place)[0]
        for _ in range(round(1.5 * length / 0.2)):
            left, turn = told(world.params.paths, 0, goal, place)
            place += 0.2 * np.float32([np.cos(turn), np.sin(turn)])
        assert left < 0.75


def test_critics_are_told_and_policies_are_not(paper):
    _, task, world = paper
    check_task(task, world)
    plain, _ = Rooms(table="2").make()
    assert task.observation_space == plain.observation_space
    assert task.privileged_space == plain.privileged_space | {"path": Box((3,))}
    state = task.reset(jax.random.key(0), jax.tree.map(lambda leaf: leaf[3], world.table), world.params)
    known = task.privileged(state, world.params)
    np.testing.assert_array_equal(known["drone"], plain.privileged(state, world.params)["drone"])
    length, turn = told(world.params.paths, 0, state.config.goal, state.qpos[:2])
    heading = 2 * np.arctan2(state.qpos[6], state.qpos[3])
    np.testing.assert_allclose(known["path"][0] * DISTANCE_SCALE, length, rtol=1e-6)
    assert turned(np.arctan2(*known["path"][1:]) + heading - turn) < 1e-5


def test_only_training_gets_the_paths_ready():
    agent = PPO(num_envs=8, num_steps=4, num_minibatches=2)
    settings = RunSettings(task=Rooms(critic_paths=True), agent=agent)
    assert build(settings, 1).world.params.paths is not None
    flown = build(settings, 1, trains=False)
    assert flown.world.params.paths is None
    # A training without them stops at the first figure that is not finite.
    state = flown.agent.init(jax.random.key(0), flown.world)
    assert jax.device_get(flown.agent.iterate(state, flown.world)[1]).non_finite
    assert build(RunSettings(task=Rooms(), agent=agent), 1).world.params.paths is None


def test_thousands_of_goals_are_found_by_their_cells():
    """Goals are told of as well as they would be alone, but for up to a cell's diagonal."""
    goal = np.random.default_rng(0).uniform((1, 1), (4.5, 7), (4_000, 2)).astype(np.float32)
    goal[:100] = np.round(goal[:100], 1)  # half of their coordinates lie between two cells
    bank = MapBank(WALL[0][None], WALL[1][None], ROOM[None])
    place = np.float32([8, 2])

    def of(goals):
        table = Configurations(start=goals, goal=goals, map_id=np.zeros(len(goals), np.int32))
        return make_path_fields(bank, [table], radius=0.2, flight_height=1.2)

    many = of(goal)
    assert many.length.shape[1] <= np.prod(np.ptp(goal, axis=0) / CELL + 2)
    for one in [*goal[:12], *goal[-12:]]:
        length, turn = told(many, 0, one, place)
        alone, wanted = told(of(one[None]), 0, one, place)
        np.testing.assert_allclose(length, alone, atol=np.sqrt(2) * CELL + 0.25)
        assert turned(turn - wanted) < 0.1
        np.testing.assert_allclose(told(many, 0, one, one)[0], 0, atol=np.sqrt(2) * CELL + 0.25)


def test_a_training_looks_for_them_once(monkeypatch, tmp_path):
    """And not where it only makes sure that it can begin."""
    looked = []

    def for_training(settings, world):
        looked.append(settings)
        return settings.with_paths(world, world.table)

    monkeypatch.setattr(Rooms, "for_training", for_training)
    agent = PPO(num_envs=8, num_steps=4, num_minibatches=2)
    stop, few = StopSettings(iterations=1), EvaluationSettings(every=1, episodes=2)
    train(RunSettings(task=Rooms(critic_paths=True), agent=agent, stop=stop, evaluation=few), tmp_path, 1)
    assert len(looked) == 1


def test_too_many_cells_are_refused():
    goal = np.float32([(1, 4), (9, 4)])
    table = Configurations(start=goal, goal=goal, map_id=np.zeros(2, np.int32))
    many = MapBank(*(np.broadcast_to(part, (10_000, *part.shape)) for part in (*WALL, 20 * ROOM)))
    with pytest.raises(InputError, match=r"the paths to 2 goals in each of 10,000 maps take 45 GiB, 1 is"):
        make_path_fields(many, [table], radius=0.2, flight_height=1.2)


def test_guided_is_shown_what_critics_are_told():
    guided, world = bounds.Guided(table="2").make()
    task, told_world = (settings := Rooms(table="2", critic_paths=True)).make()
    told_world = settings.for_training(told_world)
    state = task.reset(jax.random.key(1), jax.tree.map(lambda leaf: leaf[5], world.table), world.params)
    shown = guided.observe(jax.random.key(0), state, world.params)["way"]
    np.testing.assert_array_equal(shown, task.privileged(state, told_world.params)["path"])
    check_task(guided, world)
    assert bounds.Guided(table="2", critic_paths=True).for_training(world) is world


@pytest.mark.slow
def test_a_run_with_a_told_critic_is_evaluated_resumed_and_exported(tmp_path):
    def pecjax_does(*words):
        done = subprocess.run(
            [sys.executable, "-m", "pecjax", *words], capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run = str(tmp_path / "run")
    few = ("--agent.num-envs", "64", "--evaluation.every", "2", "--evaluation.episodes", "20")
    few += ("--agent.auxiliary", "path")
    pecjax_does("train", "--task.critic-paths", *few, "--iterations", "2", "--out", run)
    pecjax_does("train", "--out", run, "--resume", *few, "--iterations", "4", "--task.critic-paths")
    assert "over 20 greedy episodes" in pecjax_does("eval", run, "--episodes", "20")
    pecjax_does("export", run, "--out", str(tmp_path / "policy.onnx"))
    assert (tmp_path / "policy.json").is_file()
