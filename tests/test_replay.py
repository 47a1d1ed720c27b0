"""The replay against NumPy, float64 sums, chi-square, and a plain history of all that was flown."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from pecjax.agents import Apex
from pecjax.agents.apex import agent as apex, replay, sum_tree
from pecjax.agents.apex.replay import ReplaySettings
from pecjax.agents.observations import encode, pack, unpack
from pecjax.agents.rollout import Trajectory
from pecjax.envs.spaces import Box


def tree_of(priorities):
    priorities = jnp.asarray(priorities, jnp.float32)
    return sum_tree.set_leaves(sum_tree.empty(len(priorities)), jnp.arange(len(priorities)), priorities)


def some_priorities(number, seed=0):
    draw = np.random.default_rng(seed)
    return np.where(draw.random(number) < 0.3, 0, draw.random(number) ** 3).astype(np.float32)


@pytest.mark.parametrize("number", [64, 50, 1])
@pytest.mark.parametrize("stratified", [False, True])
def test_draws_are_proportional_and_never_of_priority_zero(number, stratified):
    priorities = some_priorities(number) if number > 1 else np.float32([0.3])
    drawn = jax.jit(sum_tree.draw, static_argnums=(2, 3))(
        tree_of(priorities), jax.random.key(0), 10**6, stratified
    )
    found = np.bincount(drawn, minlength=number)
    assert found.size == number and found[priorities == 0].sum() == 0
    likely = np.float64(priorities) / np.float64(priorities).sum()
    if stratified:  # one draw a millionth: every leaf comes as often as it should, to one draw at either end
        np.testing.assert_allclose(found, 1e6 * likely, atol=2)
    elif number > 1:
        assert stats.chisquare(found[likely > 0], 1e6 * likely[likely > 0]).pvalue > 1e-3


@pytest.mark.parametrize("stratified", [False, True])
def test_leaves_of_low_priority_in_a_large_tree_are_drawn_as_often_as_they_should_be(stratified):
    """A quarter of a million of them share a fiftieth of the mass, each 8e-8 of it."""
    size = 2**18
    priorities = np.full(size, 0.02 / size, np.float32)
    priorities[::1024] += 0.98 / 256
    draw = jax.jit(sum_tree.draw, static_argnums=(2, 3))
    tree = tree_of(priorities)
    found = np.zeros(size, int)
    for key in jax.random.split(jax.random.key(2), 8):
        found += np.bincount(draw(tree, key, 2**20, stratified), minlength=size)
    rare = np.arange(size) % 1024 > 0
    mean = found.sum() * 0.02 / size
    assert 0.6 < mean < 0.7
    # How many are drawn 0, 1, 2, … times is Poisson's.
    times = np.append(np.bincount(found[rare], minlength=5)[:5], (found[rare] >= 5).sum())
    wanted = stats.poisson(mean).pmf(np.arange(5))
    wanted = rare.sum() * np.append(wanted, 1 - wanted.sum())
    assert stats.chisquare(times, wanted).pvalue > 1e-3


def test_the_root_is_the_float64_sum_after_100000_updates_with_duplicates():
    size, batch = 1000, 100

    def step(tree, key):
        key_leaf, key_priority = jax.random.split(key)
        leaves = jax.random.randint(key_leaf, (batch,), 0, size // 4)  # a third of them named twice
        values = jax.random.uniform(key_priority, (batch,)) ** 8 * 1e4
        return sum_tree.set_leaves(tree, leaves, values), (leaves, values)

    keys = jax.random.split(jax.random.key(1), 1000)
    tree, (leaves, values) = jax.jit(lambda tree: jax.lax.scan(step, tree, keys))(
        tree_of(some_priorities(size))
    )
    held = np.asarray(sum_tree.get_leaves(tree, jnp.arange(size)))
    np.testing.assert_allclose(sum_tree.total(tree), held.astype(np.float64).sum(), rtol=1e-6)
    for leaf in np.unique(leaves[-1]):
        assert held[leaf] in np.asarray(values[-1])[np.asarray(leaves[-1]) == leaf]


def find(tree, mass):
    """The leaves at which the running sum of priorities first exceeds the mass."""
    nodes, _ = sum_tree.descend(tree, jnp.ones(mass.shape, jnp.int32), mass, sum_tree.depth_of(tree))
    return nodes - tree.size // 2


def test_mass_that_rounding_left_over_finds_the_last_leaf_with_any():
    tree = tree_of([0, 0.1, 0.3, 0, 0.2, 0, 0])
    mass = jnp.array([0.0, 0.0999, 0.1001, 0.3999, 0.4001, 0.6, 0.7, 9.0])
    np.testing.assert_array_equal(find(tree, mass), [1, 1, 2, 2, 4, 4, 4, 4])


def test_finding_inverts_the_running_sum():
    priorities = some_priorities(777, seed=3)
    running = np.cumsum(priorities, dtype=np.float64)
    mass = np.random.default_rng(4).uniform(0, running[-1], 2000)
    found = find(tree_of(priorities), jnp.float32(mass))
    expected = np.searchsorted(running, mass, side="right")
    # In float32 a mass may fall on the other side of a boundary that it is next to.
    near = np.abs(running[:, None] - mass).min(axis=0) < 1e-4
    np.testing.assert_array_equal(np.asarray(found)[~near], expected[~near])
    assert near.mean() < 0.05


SPACE = {
    "depth": Box((3, 4), 0.01, 1.0),
    "goal": Box((2,), -3.0, 3.0),
    "look": Box((2, 2, 3), -1.0, 4.0),
    "unbounded": Box((2, 3)),
}


def some_observations(number):
    draw = np.random.default_rng(0)
    values = {
        "depth": draw.uniform(0.01, 1, (number, 3, 4)),
        "goal": draw.uniform(-3, 3, (number, 2)),
        "look": draw.uniform(-1, 4, (number, 2, 2, 3)),
        "unbounded": draw.normal(0, 100, (number, 2, 3)),
    }
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), values)


def test_images_of_finite_bounds_are_kept_to_half_a_step_and_all_else_exactly():
    obs = some_observations(5)
    packed = pack(SPACE, obs)
    # Images first, of which only the third has no bounds to tell 255 steps between.
    assert [part.dtype for part in packed] == [jnp.uint8, jnp.uint8, jnp.float32, jnp.float32]
    assert [part.shape for part in packed] == [(5, 12), (5, 12), (5, 6), (5, 2)]
    back = unpack(SPACE, packed)
    features = encode(SPACE, obs)
    assert back.shape == features.shape and back.dtype == jnp.float32
    np.testing.assert_allclose(back[:, :12], features[:, :12], atol=0.99 / 255 / 2 + 1e-6)
    np.testing.assert_allclose(back[:, 12:24], features[:, 12:24], atol=5 / 255 / 2 + 1e-6)
    np.testing.assert_array_equal(back[:, 24:], features[:, 24:])


def test_bounds_are_kept_exactly_and_what_was_kept_stays_as_it_is():
    space = Box((1, 3), -1.0, 3.0)
    ends = jnp.float32([[-1.0, 1.0, 3.0]])
    np.testing.assert_allclose(unpack(space, pack(space, ends)), [-1, 1, 3], atol=4 / 255 / 2 + 1e-6)
    np.testing.assert_array_equal(unpack(space, pack(space, ends))[np.array([0, 2])], [-1, 3])
    every = (jnp.arange(255, dtype=jnp.uint8).reshape(85, 3),)
    seen = unpack(space, every).reshape(85, 1, 3)
    np.testing.assert_array_equal(pack(space, seen)[0], every[0])


class Flown:
    """A replay fed by made-up flights, beside a plain history of them.

    Some of their endings are cuts, beyond which there is a value.
    """

    def __init__(self, settings: Apex, seed: int):
        self.settings, self.draw = settings, np.random.default_rng(seed)
        self.action, self.reward, self.done, self.beyond = [], [], [], []
        envs, n = settings.num_envs, settings.n_step
        zero = jnp.zeros((envs, n))
        self.recent = apex.Recent(zero.astype(jnp.int32), zero, zero, zero, zero.astype(bool))
        one = replay.empty(settings.num_rows, settings.shard_envs, (jnp.zeros(2),))
        shards = settings.replay.num_shards
        self.shards = jax.tree.map(lambda leaf: jnp.zeros((shards, *leaf.shape), leaf.dtype), one)
        self._add = jax.jit(self._write)

    def _write(self, recent, shards, trajectory):
        recent, rows = apex.complete(self.settings, recent, trajectory)
        add = partial(replay.add, self.settings.replay, n_step=self.settings.n_step)
        return recent, jax.vmap(add)(shards, apex.by_shard(rows, self.settings.shard_envs))

    def fly(self):
        """One rollout; an observation says which environment saw it and when."""
        steps, envs = self.settings.rollout_length, self.settings.num_envs
        now = len(self.action)
        new = [
            self.draw.integers(0, 15, (steps, envs)),
            self.draw.normal(size=(steps, envs)).astype(np.float32),
            (self.draw.random((steps, envs)) < 0.2).astype(np.float32),
        ]
        is_cut = (new[2] == 1) & (self.draw.random((steps, envs)) < 0.5)
        new.append(np.where(is_cut, self.draw.normal(size=(steps, envs)), 0).astype(np.float32))
        for kept, rows in zip((self.action, self.reward, self.done, self.beyond), new, strict=True):
            kept.extend(rows)
        time, env = np.meshgrid(np.arange(now, now + steps), np.arange(envs), indexing="ij")
        packed = (jnp.asarray(np.stack([env, time], -1), jnp.float32),)
        action, reward, done, beyond = map(jnp.asarray, new)
        value = jnp.zeros((steps, envs))
        extras = (packed, value, value)
        trajectory = Trajectory(None, action.astype(jnp.int32), reward, done, beyond, extras)
        self.recent, self.shards = self._add(self.recent, self.shards, trajectory)

    def transition(self, env, time):
        """(action, return, discount) as the history has it."""
        total, going_on = 0.0, 1.0
        for k in range(self.settings.n_step):
            total += going_on * self.settings.reward_scale * self.reward[time + k][env]
            going_on *= self.settings.discount
            if self.done[time + k][env]:
                return self.action[time][env], total + going_on * self.beyond[time + k][env], 0.0
        return self.action[time][env], total, going_on


@pytest.mark.parametrize(
    ("num_envs", "rollout_length", "n_step", "rows", "shards"),
    [(8, 2, 3, 12, 2), (6, 4, 2, 8, 3), (4, 1, 3, 7, 1), (4, 5, 1, 10, 4)],
)
def test_what_is_drawn_is_what_was_flown_and_never_two_episodes_mixed(
    num_envs, rollout_length, n_step, rows, shards
):
    settings = Apex(
        num_envs=num_envs,
        num_actors=num_envs,
        num_steps=rollout_length,
        rollout_length=rollout_length,
        n_step=n_step,
        batch_size=shards,
        replay_ratio=shards / (rollout_length * num_envs),
        replay=ReplaySettings(capacity=rows * num_envs, num_shards=shards),
    )
    settings.check()
    flown = Flown(settings, seed=rows)
    draw = jax.jit(
        jax.vmap(
            lambda shard, key: replay.sample(settings.replay, shard, key, 50, settings.shard_envs, n_step)
        )
    )
    seen = set()
    for turn in range(3 * rows // rollout_length + 2):  # the ring is written over three times
        flown.fly()
        written = len(flown.action)
        leaves = flown.shards.tree[:, flown.shards.tree.shape[1] // 2 :]
        # A row whose window reaches back before the first, or into what was overwritten, is none.
        expected = max(0, min(written, rows) - n_step) * num_envs
        assert int((leaves > 0).sum()) == expected
        if expected == 0:
            continue
        batch = draw(flown.shards, jax.random.split(jax.random.key(turn), shards))
        for shard in range(shards):
            for i in range(50):
                env, time = map(int, batch.obs[0][shard, i])
                assert env // settings.shard_envs == shard
                assert written - rows <= time < written - n_step + 1
                np.testing.assert_array_equal(batch.next_obs[0][shard, i], [env, time + n_step])
                action, total, discount = flown.transition(env, time)
                assert batch.action[shard, i] == action
                np.testing.assert_allclose(batch.reward[shard, i], total, rtol=1e-5, atol=1e-7)
                np.testing.assert_allclose(batch.discount[shard, i], discount, rtol=1e-5)
                seen.add(discount > 0)
    assert seen == {True, False}


@pytest.mark.parametrize("normalize", ["batch", "shard"])
def test_weights_are_those_of_schaul_et_al(normalize):
    settings = ReplaySettings(alpha=0.6, beta=0.4, epsilon=1e-6, normalize=normalize)
    errors = np.random.default_rng(5).exponential(size=40).astype(np.float32)
    shard = replay.empty(10, 4, (jnp.zeros(1),))
    shard = replay.reprioritize(settings, shard, jnp.arange(40), jnp.asarray(errors))
    batch = replay.sample(settings, shard, jax.random.key(0), 16, 4, 3)
    chances = (np.float64(errors) + 1e-6) ** 0.6
    chances /= chances.sum()
    weights = (40 * chances) ** -0.4
    greatest = weights.max() if normalize == "shard" else weights[np.asarray(batch.leaf)].max()
    np.testing.assert_allclose(batch.weight, weights[np.asarray(batch.leaf)] / greatest, rtol=1e-4)


def test_a_new_error_is_a_new_priority_and_no_error_is_none():
    settings = ReplaySettings(alpha=0.5, epsilon=0.0)
    shard = replay.empty(4, 2, (jnp.zeros(1),))
    shard = replay.reprioritize(settings, shard, jnp.array([1, 5, 6]), jnp.array([4.0, 9.0, -1.0]))
    held = sum_tree.get_leaves(shard.tree, jnp.arange(8))
    np.testing.assert_allclose(held, [0, 2, 0, 0, 0, 3, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(sum_tree.total(shard.tree), 5, rtol=1e-6)
