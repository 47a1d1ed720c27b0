"""The curriculum in loops over Gymnasium: counts, draws, and episodes in the row that they say."""

import functools
import importlib
import pickle
import sys
from multiprocessing import get_context
from pathlib import Path

import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import RecordEpisodeStatistics
from scipy import stats
from tiny_gymnasium import Countdown

from pecjax.curriculum import Outcomes, pec, per_step, uniform
from pecjax.curriculum.wrappers.chooser import Chooser
from pecjax.curriculum.wrappers.gymnasium import CurriculumVectorWrapper, CurriculumWrapper
from pecjax.errors import InputError

N, B = 6, 5
LENGTH = np.array([1, 2, 3, 4, 7, 2])
FALLS = np.array([True, False, True, True, False, False])
START = np.arange(2 * N, dtype=np.float32).reshape(N, 2)  # a row of it is an array
TABLE = {"length": LENGTH, "falls": FALLS, "start": START}


def fell(reward, terminated, truncated, info):
    """As the episode's last step says."""
    assert type(reward) is float and info["over"] and (terminated or truncated)
    assert ("why" in info) == terminated
    return terminated


def vector_env(kind, mode=AutoresetMode.DISABLED):
    make = [functools.partial(RecordEpisodeStatistics, Countdown()) for _ in range(B)]
    if kind == "sync":
        return SyncVectorEnv(make, autoreset_mode=mode)
    if kind == "sync, not copied":
        return SyncVectorEnv(make, autoreset_mode=mode, copy=False)
    shared = kind == "async"
    return AsyncVectorEnv(make, context="spawn", shared_memory=shared, autoreset_mode=mode)


class Tally:
    """What the sampler should have counted, by what the loop has seen."""

    def __init__(self):
        self.counts, self.expected, self.drawn = np.zeros((2, N), int), np.zeros(N), np.zeros(N)

    def draw(self, ids, probabilities):
        probabilities = np.asarray(probabilities, float)
        self.expected += len(ids) * probabilities / probabilities.sum()
        self.drawn += np.bincount(ids, minlength=N)

    def end(self, config_id, failed):
        self.counts[:, config_id] += [1, failed]


@pytest.mark.parametrize("kind", ["sync", "sync, not copied", "async", "async, not shared"])
def test_side_by_side_counts_are_a_tallys_and_each_flies_in_its_row(kind):
    sampler = pec(N, alpha=0.1)
    envs = CurriculumVectorWrapper(vector_env(kind), sampler, TABLE, failed=fell, seed=3)
    try:
        observations, infos = envs.reset(seed=5)
        check_loop(envs, sampler, np.array(observations), infos, steps=200 if "async" in kind else 500)
    finally:
        envs.close()


def check_loop(envs, sampler, observations, infos, steps):
    """Steps, looking only at what the environments show."""
    probabilities = jax.jit(sampler.probabilities)
    tally = Tally()
    ids, so_far, begun = infos["config_id"], np.zeros(B, int), infos["begun"]
    total = np.zeros(B)
    tally.draw(ids, probabilities(envs.chooser.state))
    for n in range(steps):
        np.testing.assert_array_equal(observations[:, 0], so_far)
        np.testing.assert_array_equal(observations[:, 1], START[ids].sum(axis=1))
        actions = np.arange(n, n + B) % 2
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        observations = np.array(observations)
        so_far, total = so_far + 1, total + rewards
        # It ends as its row says.
        np.testing.assert_array_equal(terminated, (so_far == LENGTH[ids]) & FALLS[ids])
        np.testing.assert_array_equal(truncated, (so_far == LENGTH[ids]) & ~FALLS[ids])
        ended, now = terminated | truncated, infos["config_id"]
        assert ("final_obs" in infos) == ended.any() and infos["_config_id"].all()
        np.testing.assert_array_equal(now[~ended], ids[~ended])
        np.testing.assert_array_equal(infos.get("_steps", np.zeros(B, bool)), ~ended)
        for k in np.flatnonzero(ended):
            tally.end(ids[k], terminated[k])
            # As Gymnasium's own reset within the step tells it.
            np.testing.assert_array_equal(infos["final_obs"][k], [LENGTH[ids[k]], START[ids[k]].sum()])
            final = infos["final_info"]
            assert infos["_final_obs"][k] and infos["_final_info"][k] and final["_steps"][k]
            assert (final["config_id"][k], final["steps"][k]) == (ids[k], LENGTH[ids[k]])
            assert final["episode"]["r"][k] == total[k] and final["episode"]["l"][k] == so_far[k]
            assert infos["_begun"][k]
        assert not ended.any() or not infos["_final_obs"][~ended].any()
        tally.draw(now[ended], probabilities(envs.chooser.state))
        ids, so_far, total = now, np.where(ended, 0, so_far), np.where(ended, 0, total)
    np.testing.assert_array_equal(envs.chooser.state.statistics, tally.counts)
    assert tally.counts[0].min() > 5 and begun.shape == (B,)
    assert stats.chisquare(tally.drawn, tally.expected).pvalue > 1e-3
    # Uniform draws would not pass.
    assert stats.chisquare(tally.drawn).pvalue < 1e-3


def test_the_loop_sees_what_gymnasiums_own_reset_within_the_step_shows():
    """With one configuration both can do it."""
    row = {name: values[2:3] for name, values in TABLE.items()}
    make = [functools.partial(Countdown, extra=n, default=Chooser(uniform(1), row).row(0)) for n in range(B)]
    theirs = SyncVectorEnv(make, autoreset_mode=AutoresetMode.SAME_STEP)
    envs = SyncVectorEnv(make, autoreset_mode=AutoresetMode.DISABLED)
    ours = CurriculumVectorWrapper(envs, uniform(1), row, failed=fell)
    assert data_equivalence(theirs.reset(seed=2), without_ids(ours.reset(seed=2)), exact=True)
    for n in range(60):
        actions = np.arange(n, n + B) % 2
        assert data_equivalence(theirs.step(actions), without_ids(ours.step(actions)), exact=True)


def without_ids(told):
    """What a reset or a step returns, but for the configurations in its infos."""

    def pruned(infos):
        return {
            name: pruned(value) if isinstance(value, dict) else value
            for name, value in infos.items()
            if not name.endswith("config_id")
        }

    return (*told[:-1], pruned(told[-1]))


def test_the_same_seeds_give_the_same_loop():
    def loop(seed):
        envs = CurriculumVectorWrapper(vector_env("sync"), pec(N), TABLE, failed=fell, seed=seed)
        told = [envs.reset(seed=1)[1]["begun"]]
        for _ in range(30):
            infos = envs.step(np.zeros(B, int))[4]
            told += [infos["config_id"], infos.get("begun", np.zeros(B, int))]
        return np.stack(told)

    np.testing.assert_array_equal(loop(0), loop(0))
    assert (loop(0) != loop(1)).any()


def test_one_by_one_they_share_a_chooser():
    sampler = pec(N, alpha=0.1)
    chooser = Chooser(sampler, TABLE, seed=1)
    envs = [CurriculumWrapper(Countdown(), chooser, failed=fell) for _ in range(3)]
    tally, probabilities = Tally(), jax.jit(sampler.probabilities)
    for n in range(900):
        env, chances = envs[n % 3], probabilities(chooser.state)
        observation, info = env.reset(options={"length": 99})  # the row goes before it
        config_id = info["config_id"]
        tally.draw([config_id], chances)
        if n % 10 == 9:
            continue  # given up: does not count
        for step in range(1, LENGTH[config_id] + 1):
            assert observation[1] == START[config_id].sum()
            observation, _, terminated, truncated, info = env.step(0)
            assert info["config_id"] == config_id and info["steps"] == step
            assert (terminated or truncated) == (step == LENGTH[config_id])
        tally.end(config_id, terminated)
    np.testing.assert_array_equal(chooser.state.statistics, tally.counts)
    assert tally.counts[0].sum() == 810
    assert stats.chisquare(tally.drawn, tally.expected).pvalue > 1e-3
    assert stats.chisquare(tally.drawn).pvalue < 1e-3


@pytest.mark.parametrize("vector", [True, False])
def test_the_sampler_hears_lengths(vector):
    """One that draws shares of steps knows how long each episode took."""
    sampler = per_step(uniform(N))
    if vector:
        envs = CurriculumVectorWrapper(vector_env("sync"), sampler, TABLE, failed=fell)
        chooser = envs.chooser
    else:
        chooser = Chooser(sampler, TABLE)
        envs = CurriculumWrapper(Countdown(), chooser, failed=fell)
    envs.reset(seed=0)
    for _ in range(600):
        _, _, terminated, truncated, _ = envs.step(np.zeros(B, int) if vector else 0)
        if not vector and (terminated or truncated):
            envs.reset()
    wanted = 1 / LENGTH
    np.testing.assert_allclose(sampler.probabilities(chooser.state), wanted / wanted.sum(), rtol=1e-5)


def test_a_chooser_goes_on_where_another_has_stopped():
    def work(chooser):
        drawn = []
        for n in range(20):
            drawn.append(chooser.sample(4))
            chooser.update(Outcomes(drawn[-1], True, drawn[-1] % 2, n, 0.5))
        return np.stack(drawn)

    one, other = (Chooser(pec(N), TABLE, seed=7) for _ in range(2))
    work(one)
    kept = pickle.loads(pickle.dumps((jax.device_get(one.state), one.draws)))
    other.state, other.draws = kept
    np.testing.assert_array_equal(work(one), work(other))
    jax.tree.map(np.testing.assert_array_equal, one.state, other.state)
    with pytest.raises(InputError, match=f"not one of a sampler like this over {N}"):
        other.state = pec(N + 1).init()


def test_a_row_is_the_environments_to_keep():
    chooser = Chooser(pec(N), TABLE | {"name": np.array([*"abcdef"], object)})
    row = chooser.row(np.int32(2))
    assert row["length"] == 3 and type(row["length"]) is int and row["name"] == "c"
    row["start"][:] = -1
    np.testing.assert_array_equal(chooser.row(2)["start"], START[2])


def draws(chooser, answers):
    """In a forked process, where nothing of JAX may run."""
    try:
        answers.send(chooser.sample(1))
    except InputError as error:
        answers.send(str(error))


def test_a_chooser_works_in_one_process():
    """Copies in others would count for themselves."""
    chooser = Chooser(pec(N), TABLE)
    with pytest.raises(InputError, match="DummyVecEnv"):
        pickle.dumps(chooser)
    here, there = get_context("fork").Pipe()
    with pytest.warns(RuntimeWarning, match="fork"):
        process = get_context("fork").Process(target=draws, args=(chooser, there))
        process.start()
    assert "works in the process that made it" in here.recv()
    process.join(60)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_environments_that_reset_by_themselves_are_refused(mode):
    envs = vector_env("sync", mode)
    vector_env("sync")  # the newest, whose mode its class remembers
    with pytest.raises(InputError, match=rf"mode {mode.name} .* autoreset_mode=AutoresetMode\.DISABLED"):
        CurriculumVectorWrapper(envs, pec(N), TABLE, failed=fell)
    envs = CurriculumVectorWrapper(vector_env("sync"), pec(N), TABLE, failed=fell)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_what_cannot_be_meant_is_refused():
    with pytest.raises(InputError, match=rf"table: length has shape \(3,\); .* {N} configurations"):
        Chooser(pec(N), {"length": [1, 2, 3]})
    envs = CurriculumVectorWrapper(vector_env("sync"), pec(N), TABLE, failed=lambda *_: -1.0)
    with pytest.raises(InputError, match="options has a reset_mask"):
        envs.reset(options={"reset_mask": np.ones(B, bool)})
    envs.reset()
    with pytest.raises(InputError, match=r"failed is -1\.0"):
        for _ in range(8):
            envs.step(np.zeros(B, int))


def test_stable_baselines3_counts_what_its_environments_ended(monkeypatch, capsys):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(sys, "path", [*sys.path, str(Path(__file__).parents[1] / "examples")])
    ended, chooser = importlib.import_module("stable_baselines3_cartpole").main(num_steps=4096)
    counts = np.zeros_like(chooser.state.statistics)
    for config_id, failed in ended:
        counts[:, config_id] += [1, failed]
    np.testing.assert_array_equal(chooser.state.statistics, counts)
    assert counts[0].sum() > 50 and "fell" in capsys.readouterr().out
