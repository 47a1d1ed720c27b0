"""The curriculum under Brax's wrappers: what it hears, what it draws, and what is flown then."""

import importlib
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import Env, State
from brax.envs.wrappers.training import EpisodeWrapper, EvalWrapper
from brax.training.acting import Evaluator
from flax import struct
from scipy import stats

from pecjax.curriculum import Sampler, by_config, pec
from pecjax.curriculum.wrappers.brax import AXIS, curriculum_wrap
from pecjax.curriculum.wrappers.brax_rows import TableVmapWrapper
from pecjax.errors import InputError

NUM = 6
TABLE = {
    "length": np.array([1, 2, 3, 5, 8, 13], np.int32),
    "chance": np.array([0, 1, 0, 1, 0.5, 0], np.float32),  # of being lost
    "gain": np.linspace(0.5, 3, NUM).astype(np.float32),
}


@struct.dataclass
class PlaygroundState:
    """The fields of MuJoCo Playground's states, which has `data` where Brax has `pipeline_state`."""

    data: Any
    obs: Any
    reward: Any
    done: Any
    metrics: Any
    info: Any


class Walk(NamedTuple):
    length: Any
    clock: Any
    place: Any


class Walker(Env):
    """Walks for as many steps as its row says, `sys["gain"]` times as far as it is told to."""

    def __init__(self):
        self.sys = {"gain": jnp.float32(1.0)}

    def make_state(self, walk, zero, info):
        return State(walk, self.observe(walk), zero, zero, {"lost": zero, "walked": zero}, info)

    def reset_to(self, row, rng):
        zero = jnp.zeros(())
        walk = Walk(row["length"], jnp.int32(0), zero)
        info = {"lost": jax.random.uniform(rng) < row["chance"], "scale": 2 * self.physics()["gain"]}
        return self.make_state(walk, zero, info)

    def reset(self, rng):
        return self.reset_to({"length": jnp.int32(4), "chance": 0.0}, rng)

    def step(self, state, action):
        walk = self.walk_of(state)
        walk = Walk(walk.length, walk.clock + 1, walk.place + self.physics()["gain"] * action)
        over = walk.clock >= walk.length
        metrics = {"lost": (over & state.info["lost"]).astype(jnp.float32), "walked": walk.place}
        return self.with_walk(state, walk).replace(
            obs=self.observe(walk),
            reward=walk.place,
            done=over.astype(jnp.float32),
            metrics=state.metrics | metrics,
        )

    def observe(self, walk):
        return {"length": walk.length, "clock": jnp.full(2, walk.clock), "place": walk.place}

    def physics(self):
        return self.sys

    def walk_of(self, state):
        return state.pipeline_state

    def with_walk(self, state, walk):
        return state.replace(pipeline_state=walk)

    observation_size, action_size, backend = 1, 1, "none"


class PlaygroundWalker(Walker):
    def __init__(self):
        self._mjx_model = {"gain": jnp.float32(1.0)}

    def make_state(self, walk, zero, info):
        return PlaygroundState(walk, self.observe(walk), zero, zero, {"lost": zero, "walked": zero}, info)

    def physics(self):
        return self._mjx_model

    def walk_of(self, state):
        return state.data

    def with_walk(self, state, walk):
        return state.replace(data=walk)


def lost(state):
    return state.info["lost"]


def wrapped(sampler, env=None, episode_length=1000, action_repeat=1, **more):
    wrap = curriculum_wrap(sampler, TABLE, reset_to=Walker.reset_to, failed=lost, **more)
    return wrap(env or Walker(), episode_length=episode_length, action_repeat=action_repeat)


def walk(env, steps, envs, sampler, seed=1):
    """(first state, last state, what was to be seen after each step (T, B, ...)), all at speed 1."""

    def step(state, _):
        state = env.step(state, jnp.ones(envs))
        own = state.info["curriculum"].sampler
        seen = {"done": state.done, "obs": state.obs, "reward": state.reward, **state.metrics}
        seen |= {name: state.info[name] for name in ("config_id", "steps", "truncation", "scale")}
        return state, seen | {"probabilities": sampler.probabilities(own)}

    first = env.reset(jax.random.split(jax.random.PRNGKey(seed), envs))
    last, rows = jax.lax.scan(step, first, None, steps)
    return first, last, rows


def tally(first_id, rows):
    """Trials and failures (2, N), counted from what the steps gave."""
    counts = np.zeros((2, NUM), int)
    current = np.array(first_id)
    for done, failed, ids in zip(*(np.asarray(rows[k]) for k in ("done", "lost", "config_id")), strict=True):
        for env in np.flatnonzero(done):
            counts[:, current[env]] += 1, int(failed[env])
        np.testing.assert_array_equal(ids[done == 0], current[done == 0])
        current = ids
    return counts


@pytest.fixture(scope="module")
def walked():
    sampler = pec(NUM, 0.05)
    program = jax.jit(lambda: walk(wrapped(sampler), 400, 32, sampler))
    return jax.tree.map(np.asarray, program())


def test_the_sampler_hears_of_every_episode_once(walked):
    first, last, rows = walked
    counts = tally(first.info["config_id"], rows)
    np.testing.assert_array_equal(last.info["curriculum"].sampler.statistics, counts)
    assert counts[0].min() > 20 and 0 < counts[1, 4] < counts[0, 4]
    assert last.info["curriculum"].step == 400


def test_ids_are_drawn_by_the_probabilities_in_force(walked):
    _, _, rows = walked
    ended = rows["done"] == 1
    found = np.bincount(rows["config_id"][ended], minlength=NUM)
    in_force = rows["probabilities"].astype(float)
    expected = ended.sum(axis=1) @ (in_force / in_force.sum(axis=1, keepdims=True))
    assert stats.chisquare(found, expected).pvalue > 1e-3
    assert stats.chisquare(found, np.full(NUM, found.sum() / NUM)).pvalue < 1e-6


def test_an_episode_is_of_the_row_that_it_says(walked):
    first, _, rows = walked
    for env in range(32):
        ends = np.flatnonzero(rows["done"][:, env])
        ids = [first.info["config_id"][env], *rows["config_id"][ends, env]]
        np.testing.assert_array_equal(np.diff([-1, *ends]), TABLE["length"][ids[:-1]])
        np.testing.assert_array_equal(rows["walked"][ends, env], TABLE["length"][ids[:-1]])
    # What is observed at an ending is the beginning of the next, as under Brax's automatic reset.
    np.testing.assert_array_equal(rows["obs"]["length"], TABLE["length"][rows["config_id"]])
    ended = rows["done"] == 1
    assert not rows["obs"]["clock"][ended].any() and not rows["obs"]["place"][ended].any()
    assert not rows["truncation"].any()
    np.testing.assert_array_equal(rows["obs"]["clock"][~ended], np.stack([rows["steps"][~ended]] * 2, -1))


def sums_only():
    """Remembers episodes, their lengths and their returns (3, N), and draws uniformly."""

    def update(state, outcomes, axis_name=None):
        told = outcomes._replace(signal=1.0)
        names = ("signal", "length", "episode_return")
        return state + jnp.stack([by_config(told, name, NUM, axis_name=axis_name) for name in names])

    def sample(state, key, shape=()):
        return jax.random.randint(key, np.atleast_1d(shape), 0, NUM)

    return Sampler(lambda: jnp.zeros((3, NUM)), lambda state: jnp.full(NUM, 1 / NUM), sample, update)


def test_brax_truncates_and_the_sampler_hears_of_length_and_return():
    env, sampler = wrapped(sums_only(), episode_length=4, action_repeat=2), sums_only()
    first, last, rows = jax.tree.map(np.asarray, jax.jit(lambda: walk(env, 40, 8, sampler))())
    expected = np.zeros((3, NUM))
    for column in range(8):
        start, config = 0, first.info["config_id"][column]
        for end in np.flatnonzero(rows["done"][:, column]):
            rewards = rows["reward"][start : end + 1, column]
            # Brax repeats an action beyond an ending: one of an odd length is a step too long.
            expected[:, config] += 1, 2 * len(rewards), rewards.sum()
            over = TABLE["length"][config] <= 4
            assert len(rewards) == min(2, -(-TABLE["length"][config] // 2))
            assert rows["truncation"][end, column] == (not over)
            start, config = end + 1, rows["config_id"][end, column]
    np.testing.assert_allclose(last.info["curriculum"].sampler, expected)
    assert expected[0].min() > 3


def test_devices_share_one_sampler(capsys):
    told = []
    sampler = pec(NUM)
    env = wrapped(sampler, callback=told.append, every=25)
    devices = jax.devices()[:2]

    def train(keys):
        def step(state, _):
            state = env.step(state, jnp.ones(4))
            return state, (state.done, state.metrics["lost"], state.info["config_id"])

        first = env.reset(keys)
        last, rows = jax.lax.scan(step, first, None, 60)
        return first.info["config_id"], last.info["curriculum"], rows

    keys = jax.random.split(jax.random.PRNGKey(0), 8).reshape(2, 4, 2)
    first, own, rows = jax.tree.map(np.asarray, jax.pmap(train, axis_name=AXIS, devices=devices)(keys))
    jax.effects_barrier()
    named = [dict(zip(("done", "lost", "config_id"), (r[d] for r in rows), strict=True)) for d in range(2)]
    counts = [tally(first[device], named[device]) for device in range(2)]
    assert (own.key[0] != own.key[1]).any() and (counts[0] != counts[1]).any()
    for device in range(2):
        np.testing.assert_array_equal(own.sampler.statistics[device], sum(counts))
    # The first device alone calls back, at steps 25 and 50.
    until = [
        sum(tally(first[d], {k: v[:n] for k, v in named[d].items()}) for d in range(2)) for n in (25, 50)
    ]
    np.testing.assert_array_equal([state.statistics for state in told], until)
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(told))


def test_evaluation_is_uniform_and_says_nothing_to_the_training():
    told = []
    sampler = pec(NUM, 0.0)
    env = wrapped(sampler, callback=told.append, every=1)
    flown = jax.jit(EvalWrapper(env).reset)(jax.random.split(jax.random.PRNGKey(0), 3000))
    found = np.bincount(flown.info["config_id"], minlength=NUM)
    assert stats.chisquare(found).pvalue > 1e-3

    def policy(params):
        return lambda obs, key: (jnp.ones(600), {})

    evaluator = Evaluator(env, policy, 600, episode_length=30, action_repeat=1, key=jax.random.PRNGKey(1))
    metrics = evaluator.run_evaluation((), {})
    jax.effects_barrier()
    assert not told
    # Of the first episodes alone, though the sampler of α 0 draws nothing but what is lost afterwards.
    chance = TABLE["chance"].mean()
    assert abs(metrics["eval/episode_lost"] - chance) < 4 * np.sqrt(chance * (1 - chance) / 600)
    assert abs(metrics["eval/avg_episode_length"] - TABLE["length"].mean()) < 4 * TABLE["length"].std() / 24


@pytest.mark.parametrize("kind", [Walker, PlaygroundWalker])
def test_physics_are_those_of_the_row(kind):
    sampler = pec(NUM)
    env = kind()
    whole = wrapped(sampler, env, system=lambda sys, row: sys | {"gain": sys["gain"] * row["gain"]})
    first, _, rows = jax.tree.map(np.asarray, jax.jit(lambda: walk(whole, 60, 8, sampler))())
    assert env.physics() == {"gain": 1.0}  # lent for the trace only
    for column in range(8):
        ids = np.append(first.info["config_id"][column], rows["config_id"][:, column])
        state = None
        for step, done in enumerate(rows["done"][:, column]):
            bare = kind()
            bare.physics()["gain"] = jnp.float32(TABLE["gain"][ids[step]])
            row = jax.tree.map(lambda leaf, at=ids[step]: jnp.asarray(leaf)[at], TABLE)
            state = bare.reset_to(row, jax.random.PRNGKey(0)) if state is None else state
            state = bare.step(state, jnp.ones(()))
            np.testing.assert_allclose(rows["walked"][step, column], state.metrics["walked"], rtol=1e-6)
            state = None if done else state
        np.testing.assert_allclose(rows["scale"][:, column], 2 * TABLE["gain"][ids[1:]], rtol=1e-6)
    assert len(np.unique(rows["config_id"])) == NUM


def test_rows_that_are_asked_for_are_begun_and_stepped():
    rows = TableVmapWrapper(Walker(), TABLE, Walker.reset_to, lambda key, number: jnp.arange(number) % NUM)
    env = EpisodeWrapper(rows, 1000, 1)
    state = env.reset(jax.random.split(jax.random.PRNGKey(0), 9))
    np.testing.assert_array_equal(state.obs["length"], TABLE["length"][np.arange(9) % NUM])
    np.testing.assert_array_equal(env.step(state, jnp.ones(9)).info["config_id"], np.arange(9) % NUM)


def test_mistakes_are_named():
    with pytest.raises(InputError, match="table has 6 rows, but the sampler 7"):
        wrapped(pec(NUM + 1))
    with pytest.raises(InputError, match="every is 0"):
        wrapped(pec(NUM), every=0)
    wrap = curriculum_wrap(pec(NUM), TABLE, reset_to=Walker.reset_to, failed=lambda state: False)
    with pytest.raises(InputError, match="randomization_fn"):
        wrap(Walker(), randomization_fn=lambda sys: (sys, None))
    env = wrap(Walker())
    with pytest.raises(InputError, match=r"failed gives shape \(\).*give \(4,\)"):
        jax.eval_shape(lambda: env.step(env.reset(jax.random.split(jax.random.PRNGKey(0), 4)), jnp.ones(4)))
    bare = Walker()
    del bare.sys
    with pytest.raises(InputError, match="Walker has neither"):
        wrapped(pec(NUM), bare, system=lambda sys, row: sys)


# Brax's own code calls what JAX 0.10 took away: the suite of the older JAX runs it, the newer cannot.
needs_old_jax = pytest.mark.skipif(
    not hasattr(jax, "device_put_replicated"), reason="Brax 0.14.2's PPO needs a JAX before 0.10"
)
TINY = {"num_envs": 16, "batch_size": 16, "num_minibatches": 2, "num_eval_envs": 8, "num_evals": 1}


@pytest.fixture
def example(monkeypatch):
    folder = str(Path(__file__).parents[1] / "examples")
    monkeypatch.setattr(sys, "path", [*sys.path, folder])
    return importlib.import_module


@pytest.mark.slow
@needs_old_jax
@pytest.mark.filterwarnings("ignore:Brax System, piplines and environments are not:UserWarning")
def test_brax_ppo_trains_on_the_reacher(example):
    told = example("brax_reacher").main(every=16, num_timesteps=1280, episode_length=20, **TINY)
    # 1,280 steps are 80 of each environment; nothing but the time ends an episode.
    trials = [state.statistics[0].sum() for state in told]
    assert trials == [16 * (steps // 20) for steps in (16, 32, 48, 64, 80)]
    assert (told[-1].statistics[1] <= told[-1].statistics[0]).all()


@pytest.mark.slow
@needs_old_jax
def test_brax_ppo_trains_in_the_rooms(example, gliding, capsys):
    few = {"unroll_length": 8, "episode_length": 12, "num_timesteps": 1536}
    told = example("brax_rooms").main(every=24, **few, **TINY)
    trials, failures = (np.array([state.statistics[row].sum() for state in told]) for row in (0, 1))
    # Of each environment 96 steps, an ending at least in every twelve.
    assert trials.shape == (4,) and (trials >= 16 * 2 * np.arange(1, 5)).all()
    assert (failures <= trials).all() and failures[-1] > 0
    assert "goal ratio" in capsys.readouterr().out
