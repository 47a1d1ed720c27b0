"""Evaluation against a plain loop over the environment's steps."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from probe_tasks import TARGET_WORLD, WORLD, Numbers, Target, TwoStates

import pecjax
from pecjax.agents import PPO, device_mesh
from pecjax.agents.networks import NetworkSettings
from pecjax.envs.axes import fill
from pecjax.envs.spaces import Box
from pecjax.envs.task import EvalSet, Transition, World, take_configs
from pecjax.studies.grid import StudySettings
from pecjax.studies.run import run_study
from pecjax.training import train as training
from pecjax.training.build import on_devices
from pecjax.training.evaluation import make_evaluator, stratified_config_ids
from pecjax.training.load import open_run
from pecjax.training.run_episodes import SIDE_BY_SIDE, EvalResult, run_episodes, success_by_config
from pecjax.training.settings import EvaluationSettings, StopSettings

# Steering straight at the goal reaches the first, hits a wall on the way to the second, and runs
# out of steps on the way to the third.
TABLE = fill(
    pecjax.Configurations(
        np.array([[0, -2], [0, 5], [-5, -2]], np.float32), np.array([[2, -2], [0, -2], [7, -2]], np.float32)
    )
)
LIMIT, EPISODES, SEED = 50, 7, 11


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


def policy(logits, greedy=False):
    """Steers at the goal; drawn actions differ from that as the learner's logits have it."""

    def act(obs, key):
        _, sine, cosine = obs["goal"]
        bearing = jnp.arctan2(sine, cosine)
        turning = jnp.where(bearing > 0, 4, 0)  # on the spot
        steering = jnp.where(jnp.abs(bearing) > 0.4, turning, jnp.where(bearing > 0, 13, 11))
        preferred = logits.at[steering].add(5.0)
        return jnp.argmax(preferred) if greedy else jax.random.categorical(key, preferred)

    return act


@pytest.fixture(scope="module")
def rooms(scene):
    """A task, and its world."""
    env = pecjax.RoomsNavigation(scene, TABLE, pecjax.NavigationSettings(max_steps=LIMIT))
    return env.task, World(env.params, env.configurations)


@pytest.fixture(scope="module")
def evaluators(rooms):
    """(devices, greedy) -> fly; seven episodes, which two devices cannot share evenly."""
    task, world = rooms
    made = {}

    def get(devices: int, greedy: bool):
        if (devices, greedy) not in made:
            fly = make_evaluator(
                task,
                SimpleNamespace(policy=policy, first_memory=None),
                device_mesh(devices),
                episodes=EPISODES,
                greedy=greedy,
                seed=SEED,
            )(jnp.zeros(15), world)
            made[devices, greedy] = lambda learner: fly(learner, world)
        return made[devices, greedy]

    return get


@pytest.fixture(scope="module")
def flights(evaluators):
    return evaluators(2, True)(jnp.zeros(15))


def in_a_plain_loop(task, world, config_id: np.ndarray) -> EvalResult:
    """The same episodes one after the other, with nothing but `place`, `observe` and `step`."""
    act = jax.jit(policy(jnp.zeros(15), greedy=True))
    step, observe = jax.jit(task.step), jax.jit(task.observe)
    success, returns, lengths, poses, actions, endings = [], [], [], [], [], []
    for episode, row in enumerate(config_id):
        key = jax.random.fold_in(jax.random.key(SEED), episode)
        heading = jax.random.uniform(key, minval=-jnp.pi, maxval=jnp.pi)
        state = task.place(take_configs(TABLE, row), heading)
        total, path, taken, over = 0.0, [np.asarray(state.qpos)], [], False
        while not over:
            action = act(observe(key, state, world.params), key)
            after = step(key, state, action, world.params)
            state, over = after.state, bool(after.terminated)
            total += float(after.reward)
            path.append(np.asarray(state.qpos))
            taken.append(int(action))
        success.append(bool(after.success))
        steps = np.linalg.norm(np.diff(path, axis=0)[:, :2], axis=1)
        endings.append({name: float(value) for name, value in after.metrics.items()})
        endings[-1]["path_length"] = steps.sum()
        returns.append(total)
        lengths.append(len(taken))
        poses.append(path + [path[-1]] * (LIMIT + 1 - len(path)))
        actions.append(taken + [0] * (LIMIT - len(taken)))
    metrics = {name: np.array([of[name] for of in endings]) for name in endings[0]}
    of_all = map(np.array, (success, returns, lengths))
    return EvalResult(config_id, *of_all, metrics, np.array(poses), np.array(actions))


def test_equals_a_plain_loop(rooms, flights):
    looped = in_a_plain_loop(*rooms, stratified_config_ids(TABLE.size, EPISODES, SEED))
    for name in ("config_id", "success", "lengths", "actions"):
        np.testing.assert_array_equal(getattr(flights, name), getattr(looped, name), err_msg=name)
    assert set(flights.metrics) == {"collision", "timeout", "unstable", "path_length"}
    for name in ("collision", "timeout", "unstable"):
        np.testing.assert_array_equal(flights.metrics[name], looped.metrics[name])
    # Metres of many steps, added up in float32.
    np.testing.assert_allclose(flights.metrics["path_length"], looped.metrics["path_length"], atol=1e-3)
    np.testing.assert_allclose(flights.returns, looped.returns, rtol=1e-6)
    # Metres and parts of quaternions, after up to 5 s of flight in float32.
    np.testing.assert_allclose(flights.poses, looped.poses, atol=1e-3)
    # All three endings were there to be compared.
    by_config = [set(flights.success[flights.config_id == row].tolist()) for row in range(3)]
    assert by_config == [{True}, {False}, {False}]
    np.testing.assert_array_equal(flights.metrics["collision"], flights.config_id == 1)
    np.testing.assert_array_equal(flights.metrics["timeout"], flights.config_id == 2)
    assert set(flights.lengths[flights.config_id == 2]) == {LIMIT}
    assert max(flights.lengths[flights.config_id == 1]) < LIMIT


def test_poses_begin_at_the_start_and_rest_after_the_end(flights):
    assert flights.poses.shape == (EPISODES, LIMIT + 1, 7)
    assert flights.actions.shape == (EPISODES, LIMIT)
    np.testing.assert_array_equal(flights.poses[:, 0, :2], TABLE.start[flights.config_id])
    for poses, length in zip(flights.poses, flights.lengths, strict=True):
        np.testing.assert_array_equal(poses[length:], np.tile(poses[length], (LIMIT + 1 - length, 1)))
        assert np.any(poses[length] != poses[length - 1])  # it came to its end in flight


def test_two_devices_fly_the_episodes_of_one(evaluators):
    """With drawn actions; greedy ones, on two devices, equal the plain loop above."""
    one, two = (evaluators(devices, greedy=False)(jnp.zeros(15)) for devices in (1, 2))
    for name in ("config_id", "success", "lengths"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)
    np.testing.assert_allclose(one.returns, two.returns, rtol=1e-6)
    np.testing.assert_allclose(one.poses, two.poses, atol=1e-3)
    assert one.config_id.shape == (EPISODES,)


@pytest.mark.parametrize("greedy", [True, False])
def test_repeats_itself_exactly(evaluators, greedy):
    fly = evaluators(2, greedy)
    jax.tree.map(np.testing.assert_array_equal, fly(jnp.zeros(15)), fly(jnp.zeros(15)))


def test_drawn_actions_fly_otherwise_than_greedy_ones(evaluators, flights):
    sampled = evaluators(2, False)(jnp.zeros(15))
    np.testing.assert_array_equal(sampled.config_id, flights.config_id)
    assert np.all(np.any(sampled.poses[:, -1] != flights.poses[:, -1], axis=1))


def test_a_learner_so_sure_of_itself_draws_what_greedy_takes(evaluators):
    sure = jnp.full(15, -200.0).at[12].set(200.0)
    drawn, greedy = evaluators(2, False)(sure), evaluators(2, True)(sure)
    np.testing.assert_allclose(drawn.poses, greedy.poses, atol=1e-3)


@pytest.mark.parametrize(("num_configs", "episodes"), [(20, 200), (20, 50), (7, 3), (1, 5), (24, 1)])
def test_even_draw_is_even_and_its_own_again(num_configs, episodes):
    ids = stratified_config_ids(num_configs, episodes, seed=3)
    counts = np.bincount(ids, minlength=num_configs)
    assert len(ids) == episodes and len(counts) == num_configs
    assert counts.max() - counts.min() <= 1
    np.testing.assert_array_equal(ids, stratified_config_ids(num_configs, episodes, seed=3))


def test_what_remains_of_an_even_draw_goes_to_others_with_another_seed():
    draws = [np.bincount(stratified_config_ids(20, 50, seed)) for seed in range(20)]
    rests = {tuple(np.flatnonzero(counts == 3)) for counts in draws}
    assert len(rests) > 15 and all(len(rest) == 10 for rest in rests)
    assert {row for rest in rests for row in rest} == set(range(20))


def test_goal_ratios_equal_pandas():
    draw = np.random.default_rng(0)
    config_id, goal = draw.choice([0, 1, 2, 4, 7], 60), draw.random(60) < 0.6
    expected = pd.Series(goal).groupby(config_id).mean().reindex(range(9))
    np.testing.assert_allclose(success_by_config(config_id, goal, 9), expected)
    assert np.isnan(expected[[3, 5, 6, 8]]).all()
    flights = EvalResult(config_id, goal, None, None, {})
    np.testing.assert_allclose(flights.goal_ratios(), expected[:8])


def test_ppos_policy_takes_the_most_likely_action_or_draws_by_the_logits(env):
    settings = PPO(num_envs=1, network=NetworkSettings(hidden=(8,)))
    agent = settings.make(env.task, pecjax.curriculum.uniform(20))
    world = World(env.params, env.configurations)
    learner = jax.jit(agent.init)(jax.random.key(0), world).learner
    bias = jnp.linspace(-2, 1, 15)
    # The only parameters of this shape are the biases of the logits.
    only_bias = jax.tree.map(lambda p: bias if p.shape == (15,) else jnp.zeros_like(p), learner.params)
    assert sum(p.shape == (15,) for p in jax.tree.leaves(learner.params)) == 1
    learner = learner._replace(params=only_bias)
    obs = {"depth": jnp.ones((12, 16)), "goal": jnp.ones(3)}
    keys = jax.random.split(jax.random.key(1), 20_000)
    drawn = jax.jit(jax.vmap(agent.policy(learner), in_axes=(None, 0)))(obs, keys)
    ratios = np.bincount(drawn, minlength=15) / len(keys)
    expected = np.asarray(jax.nn.softmax(bias))
    assert np.all(np.abs(ratios - expected) < 5 * np.sqrt(expected / len(keys)))
    assert agent.policy(learner, greedy=True)(obs, keys[0]) == 14


def test_a_task_without_poses_has_its_own_metrics():
    """Episodes of one step, whose figures follow from the action by hand."""
    config_id = np.array([2, 0, 1, 0])

    def act(obs, key):
        return jnp.stack([0.8 * obs[0], 1.0 + 0.6 * obs[0]])  # off by 0.6, 0 and 0.6

    flights = run_episodes(
        Target(), TARGET_WORLD, act, jax.random.split(jax.random.key(0), 4), jnp.asarray(config_id)
    )
    assert flights.poses is None
    off = 0.6 * np.abs(config_id - 1)
    np.testing.assert_allclose(flights.metrics["distance"], off, atol=1e-6)
    np.testing.assert_allclose(flights.returns, -(off**2), atol=1e-6)
    np.testing.assert_array_equal(flights.success, config_id == 1)
    np.testing.assert_array_equal(flights.lengths, [1, 1, 1, 1])


class Words(Target):
    """Two steps, whose metrics are bits of the keys that it was given."""

    max_steps = 2
    action_space = Box((2,), 0.0, 1.0)
    metrics: ClassVar = dict.fromkeys(("reset", "seen", "acted", "stepped"), "last")

    def reset(self, key, config, params):
        return jnp.zeros((), jnp.int32), word(key)

    def step(self, key, state, action, params):
        count, first = state
        told = {"reset": first, "seen": action[0], "acted": action[1], "stepped": word(key)}
        none = jnp.zeros((), bool)
        return Transition((count + 1, first), jnp.zeros(()), count == 1, none, none, told)

    def observe(self, key, state, params):
        return word(key)[None]


def word(key):
    return (jax.random.bits(key) >> 8).astype(jnp.float32)


def test_reset_sight_policy_and_step_have_numbers_of_their_own():
    flights = run_episodes(
        Words(),
        TARGET_WORLD,
        lambda obs, key: jnp.stack([obs[0], word(key)]),
        jax.random.split(jax.random.key(0), 40),
        jnp.zeros(40, jnp.int32),
    )
    drawn = np.stack([flights.metrics[name] for name in Words.metrics])
    assert len(np.unique(drawn)) == drawn.size


def test_the_policy_shares_no_key_with_the_task():
    """Nor one that comes of splitting another's, as policies may split theirs."""
    keys = jax.random.split(jax.random.key(1), 40)
    flights = run_episodes(
        Words(),
        TARGET_WORLD,
        lambda obs, key: jnp.stack([obs[0], word(jax.random.split(key)[1])]),
        keys,
        jnp.zeros(40, jnp.int32),
    )
    assert not np.isin(flights.metrics["acted"], flights.metrics["stepped"]).any()
    assert not np.isin(flights.metrics["acted"], flights.metrics["seen"]).any()


def test_the_world_is_an_argument_of_the_program():
    def policy(learner, greedy):
        return lambda obs, key: jnp.stack([0.8 * obs[0], 1.0])

    evaluate = make_evaluator(
        Target(),
        SimpleNamespace(policy=policy, first_memory=None),
        device_mesh(1),
        episodes=6,
        greedy=True,
        seed=0,
    )(jnp.zeros(()), TARGET_WORLD)  # compiled, and for no other shapes
    there = evaluate(jnp.zeros(()), TARGET_WORLD)
    elsewhere = evaluate(jnp.zeros(()), TARGET_WORLD._replace(params=jnp.float32(0.3)))
    np.testing.assert_allclose(there.returns, 0, atol=1e-6)
    np.testing.assert_allclose(elsewhere.returns, -((0.5 * (there.config_id - 1.0)) ** 2), atol=1e-6)
    assert sorted(there.config_id) == [0, 0, 1, 1, 2, 2]


def test_an_evaluation_is_of_the_table_that_the_task_says():
    """Also where trainings draw from a part of it."""
    mesh = device_mesh(1)
    wider = EvalSet(Numbers(np.arange(5, dtype=np.float32)))
    trained_in, there = on_devices(WORLD, wider, mesh)
    np.testing.assert_array_equal(trained_in.table.number, WORLD.table.number)
    np.testing.assert_array_equal(there.table.number, wider.table.number)
    assert on_devices(WORLD, EvalSet(WORLD.table), mesh)[1].table.number.shape == (3,)


@dataclass(frozen=True)
class Elsewhere(pecjax.TaskSettings):
    """Trained on targets in reach, evaluated on five that are far away."""

    def make(self):
        return Target(), TARGET_WORLD

    def eval_set(self, world):
        return EvalSet(Numbers(np.arange(10, 15, dtype=np.float32)))


def test_trainings_and_studies_evaluate_in_the_table_that_the_task_says(tmp_path):
    agent = PPO(
        num_envs=8, num_steps=4, num_epochs=1, num_minibatches=2, network=NetworkSettings(hidden=(4,))
    )
    settings = pecjax.RunSettings(
        task=Elsewhere(), agent=agent, evaluation=EvaluationSettings(1, 5), stop=StopSettings(1)
    )
    # An action goes up to 2, and the nearest of these targets is at 7.2.
    far = -((7.2 - 2) ** 2)
    training.train(settings, tmp_path / "run", 1)
    assert pd.read_csv(tmp_path / "run" / "evaluation.csv").mean_return.max() < far
    assert pd.read_csv(tmp_path / "run" / "metrics.csv").mean_return.min() > far
    flights = open_run(tmp_path / "run").evaluator()()
    assert sorted(flights.config_id) == [*range(5)] and flights.returns.max() < far
    study = StudySettings("elsewhere", settings, (("sampler", ("pec", "uniform")),), (0,), parallel_runs=1)
    run_study(study, tmp_path / "study")
    assert pd.read_csv(tmp_path / "study" / "results.csv").mean_return.max() < far
    for path in tmp_path.glob("study/batches/0*/configurations.npz"):
        found = np.load(path)
        assert np.isnan(found["goal_ratio"]).all() and found["trials"].shape == (1, 1, 3)


def test_an_episode_is_the_same_beside_whichever_others_it_is_flown():
    """Also where more are flown than take steps at a time."""
    number = 2 * SIDE_BY_SIDE + 40
    keys, config_id = jax.random.split(jax.random.key(4), number), jnp.arange(number) % 3

    def act(obs, key):
        return jax.random.bernoulli(key, 0.2).astype(jnp.int32)

    def fly(some):
        return run_episodes(TwoStates(), WORLD, act, keys[some], config_id[some])

    together, few = fly(slice(0, number)), fly(slice(29, 33))
    jax.tree.map(lambda of_all, of_few: np.testing.assert_array_equal(of_all[29:33], of_few), together, few)
    assert len(set(together.lengths.tolist())) > 5 and together.success.all()
