"""The curriculum in loops over gymnax: counts, draws, and episodes that fly in the row that they say."""

import importlib
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from pecjax.curriculum import Outcomes, pec
from pecjax.envs.task import take_configs
from pecjax.errors import InputError

gymnax = pytest.importorskip("gymnax")
# What needs gymnax too is imported by name, once it is known to be there.
LogWrapper = importlib.import_module("gymnax.wrappers").LogWrapper
Curriculum, CurriculumParams = (
    getattr(importlib.import_module("pecjax.curriculum.wrappers.gymnax"), name)
    for name in ("Curriculum", "CurriculumParams")
)
params_table = importlib.import_module("pecjax.envs.gymnax").params_table

N, NUM_ENVS, STEPS, BATCHES = 5, 256, 100, 4
BARE, DEFAULT = gymnax.make("CartPole-v1")
LENGTH = np.linspace(0.2, 2.0, N)
LIMITS = np.array([12, 12, 30, 9, 60])  # steps, so that some succeed
TABLE = params_table(
    DEFAULT, length=LENGTH, polemass_length=DEFAULT.masspole * LENGTH, max_steps_in_episode=LIMITS
)


def tally(config_id, done, failed, number):
    """Trials and failures, one step after another."""
    counts = np.zeros((2, number), int)
    for n, ended, fell in zip(*map(np.ravel, (config_id, done, failed)), strict=True):
        if ended:
            counts[:, n] += [1, fell]
    return counts


@pytest.fixture(scope="module")
def loop():
    """Batches of steps at random, after each of which the sampler hears what happened; and its states."""
    env, sampler = Curriculum(BARE), pec(N, alpha=0.1)
    reset, step = jax.vmap(env.reset, (0, None)), jax.vmap(env.step, (0, 0, 0, None))

    @jax.jit
    def batch(state, learnt, key):
        params = CurriculumParams(TABLE, sampler.probabilities(learnt))

        def act(state, key):
            keys = jax.random.split(key, NUM_ENVS + 1)
            action = jax.random.bernoulli(keys[0], 0.5, (NUM_ENVS,)).astype(jnp.int32)
            _, after, reward, terminated, truncated, info = step(keys[1:], state, action, params)
            row = {"state": state, "action": action, "reward": reward, "after": after}
            return after, row | {"terminated": terminated, "truncated": truncated, "info": info}

        state, rows = jax.lax.scan(act, state, jax.random.split(key, STEPS))
        ended = rows["terminated"] | rows["truncated"]
        learnt = sampler.update(learnt, Outcomes(rows["info"]["config_id"], ended, rows["terminated"]))
        return state, learnt, rows

    keys = jax.random.split(jax.random.key(0), BATCHES + 1)
    learnt = sampler.init()
    first = CurriculumParams(TABLE, sampler.probabilities(learnt))
    _, state = jax.jit(reset)(jax.random.split(keys[0], NUM_ENVS), first)
    in_force, told = [], []
    for key in keys[1:]:
        in_force.append(np.asarray(sampler.probabilities(learnt), float))
        state, learnt, rows = batch(state, learnt, key)
        told.append(jax.device_get(rows))
    return learnt, np.stack(in_force), jax.tree.map(lambda *x: np.stack(x), *told)


def test_the_counts_are_those_of_an_independent_tally(loop):
    learnt, _, told = loop
    ended = told["terminated"] | told["truncated"]
    counts = tally(told["info"]["config_id"], ended, told["terminated"], N)
    np.testing.assert_array_equal(learnt.statistics, counts)
    assert (counts[0] > 100).all() and (counts[1] < counts[0]).any() and (counts[1] > 0).any()


def test_ids_are_drawn_by_the_probabilities_in_force(loop):
    _, in_force, told = loop
    assert np.ptp(in_force[-1]) > 0.1  # far from uniform
    ended = told["terminated"] | told["truncated"]
    for probabilities, begun, drawn in zip(in_force, ended, told["after"].config_id, strict=True):
        found = np.bincount(drawn[begun], minlength=N)
        expected = found.sum() * probabilities / probabilities.sum()
        assert stats.chisquare(found, expected).pvalue > 1e-3


def test_an_episode_keeps_its_row_until_it_ends(loop):
    _, _, told = loop
    ended = told["terminated"] | told["truncated"]
    np.testing.assert_array_equal(told["info"]["config_id"], told["state"].config_id)
    np.testing.assert_array_equal(
        told["after"].config_id[~ended], told["state"].config_id[~ended]
    )  # fmt: skip
    # The next step goes on in what the last has left.
    jax.tree.map(
        lambda before, after: np.testing.assert_array_equal(before[:, 1:], after[:, :-1]),
        told["state"], told["after"],
    )  # fmt: skip


def test_an_episode_flies_in_the_row_that_it_says(loop):
    """Each step again, by the environment alone."""
    _, _, told = loop
    alone = jax.jit(jax.vmap(lambda state, action, row: BARE.step_env(jax.random.key(0), state, action, row)))
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), told)
    ids = flat["info"]["config_id"]
    obs, _, reward, terminated, _ = alone(flat["state"].state, flat["action"], take_configs(TABLE, ids))
    np.testing.assert_allclose(flat["info"]["final_observation"], obs, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(flat["reward"], reward)
    np.testing.assert_array_equal(flat["terminated"], terminated)
    # Another row would be told apart.
    other, *_ = alone(flat["state"].state, flat["action"], take_configs(TABLE, (ids + 1) % N))
    assert (np.abs(flat["info"]["final_observation"] - other).max(axis=1) > 1e-3).mean() > 0.99
    # The limit too is the row's own.
    np.testing.assert_array_equal(flat["truncated"], flat["info"]["episode_length"] >= LIMITS[ids])


def test_length_and_return_are_those_of_the_episode(loop):
    _, _, told = loop
    ended = (told["terminated"] | told["truncated"]).reshape(-1, NUM_ENVS)
    info = {name: told["info"][name].reshape(ended.shape) for name in ("episode_length", "episode_return")}
    rewards, length, total = told["reward"].reshape(ended.shape), np.zeros(NUM_ENVS), np.zeros(NUM_ENVS)
    for n in range(len(ended)):
        length, total = length + 1, total + rewards[n]
        np.testing.assert_array_equal(info["episode_length"][n], length)
        np.testing.assert_allclose(info["episode_return"][n], total, rtol=1e-6)
        length[ended[n]], total[ended[n]] = 0, 0
    np.testing.assert_array_equal(told["after"].length.reshape(ended.shape)[ended], 0)


def test_wrappers_of_gymnax_go_around_it():
    """Its own log of lengths and returns says the same."""
    env, params = LogWrapper(Curriculum(BARE)), CurriculumParams(TABLE, np.ones(N) / N)
    _, state = env.reset(jax.random.key(0), params)

    def act(state, key):
        _, state, _, terminated, truncated, info = env.step(key, state, 1, params)
        return state, (terminated | truncated, info)

    _, (ended, info) = jax.jit(lambda *args: jax.lax.scan(act, *args))(
        state, jax.random.split(jax.random.key(1), 100)
    )
    assert ended.sum() > 3
    for name in ("length", "return"):
        np.testing.assert_array_equal(
            info[f"episode_{name}"][ended], info[f"returned_episode_{name}s"][ended]
        )


def test_spaces_name_and_default_params_are_the_environments():
    env, params = Curriculum(BARE), CurriculumParams(TABLE, np.ones(N))
    assert (env.name, env.num_actions) == (BARE.name, BARE.num_actions)
    assert env.action_space(params).n == 2
    np.testing.assert_array_equal(
        env.observation_space(params).high, BARE.observation_space(take_configs(TABLE, 0)).high
    )
    # A curriculum of one configuration, which is what the environment does by itself.
    _, state = env.reset(jax.random.key(0))
    assert state.config_id == 0
    after = env.step(jax.random.key(1), state, 1)
    np.testing.assert_allclose(
        after[5]["final_observation"], BARE.step(jax.random.key(1), state.state, 1)[5]["final_observation"]
    )
    assert not env.is_terminated(state, env.default_params)
    np.testing.assert_array_equal(
        env.observe(jax.random.key(0), state, None, env.default_params), BARE.get_obs(state.state)
    )


def test_what_cannot_be_meant_is_refused():
    with pytest.raises(InputError, match="this is a LogWrapper; put wrappers around"):
        Curriculum(LogWrapper(BARE))
    env = Curriculum(BARE)
    with pytest.raises(InputError, match=r"reset with EnvParams; give CurriculumParams\(table"):
        env.reset(jax.random.key(0), DEFAULT)
    with pytest.raises(InputError, match=rf"probabilities have shape \(4,\).* begin with \[\({N},\)\]"):
        env.reset(jax.random.key(0), CurriculumParams(TABLE, np.ones(4)))


def test_the_example_counts_what_its_steps_told(monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", [*sys.path, str(Path(__file__).parents[1] / "examples")])
    example = importlib.import_module("gymnax_purejaxrl")
    trials, failures, told = example.main(num_updates=2)
    np.testing.assert_array_equal([trials, failures], tally(*map(np.asarray, told), len(example.LENGTH)))
    assert trials.sum() > 300 and "fell" in capsys.readouterr().out
    lines = (Path(example.__file__)).read_text().splitlines()
    assert sum(line.endswith("# PEC") for line in lines) <= 10
