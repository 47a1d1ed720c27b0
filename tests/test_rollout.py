import jax
import numpy as np
import pytest
from conftest import glide
from jax import numpy as jnp
from jax.sharding import Mesh, PartitionSpec
from scipy import stats

import pecjax
from pecjax.agents.rollout import RolloutState, init_rollout, rollout
from pecjax.curriculum import Outcomes, pec
from pecjax.envs.rooms import navigation

NUM_ENVS, NUM_STEPS, NUM_BATCHES = 6, 14, 3
# A goal close by, a wall close by, and a goal out of reach: every ending within a few steps.
TABLE = pecjax.Configurations(
    start=np.float32([(0, -2), (7.4, -2), (3, 3)]), goal=np.float32([(0.6, -2), (0, -2), (5, 6)])
)


def act(obs, chance):
    """Any action, whatever is seen."""
    return (chance * 15).astype(jnp.int32), chance


@pytest.fixture(scope="module")
def env(scene):
    return pecjax.RoomsNavigation(scene, TABLE, pecjax.NavigationSettings(max_steps=17))


@pytest.fixture(scope="module")
def roll(env):
    sampler = pec(3)

    def batch(state, fleet, key, env_ids):
        return rollout(env, TABLE, sampler, state, act, fleet, key, env_ids, NUM_STEPS)

    return batch


@pytest.fixture(scope="module")
def first(env):
    return init_rollout(env, TABLE, pec(3), pec(3).init(), jax.random.key(0), NUM_ENVS)


@pytest.fixture(scope="module")
def batches(roll, first):
    """(fleet before, trajectory, episodes) of successive batches of one fleet."""
    fleet, fly = first, jax.jit(roll)
    flown = []
    for n in range(NUM_BATCHES):
        after, trajectory, episodes = fly(pec(3).init(), fleet, jax.random.key(n), jnp.arange(NUM_ENVS))
        flown.append((fleet, trajectory, episodes))
        fleet = after
    return flown


@pytest.fixture(scope="module")
def refly(env, first, batches):
    """Per environment, its episodes by `env.step`, as (config, return, steps, metrics, last step).

    Only observations and actions are taken from the rollout: where an episode starts, the bearing
    of the goal tells the heading.
    """
    step = jax.jit(env.step)
    place = jax.jit(lambda config, heading: env.observe(env.place(config, heading)))
    actions = np.concatenate([t.action for _, t, _ in batches])
    goals = np.concatenate([t.obs["goal"] for _, t, _ in batches])
    depths = np.concatenate([t.obs["depth"] for _, t, _ in batches])
    distances = np.linalg.norm(TABLE.goal - TABLE.start, axis=1)
    logs = []
    for n in range(NUM_ENVS):
        log, state = [], None
        for t in range(len(actions)):
            if state is None:
                config = int(np.argmin(np.abs(distances - goals[t, n, 0])))
                offset = TABLE.goal[config] - TABLE.start[config]
                heading = np.float32(np.arctan2(offset[1], offset[0]) - goals[t, n, 1])
                state = place(jax.tree.map(lambda leaf, c=config: leaf[c], TABLE), heading)
                total = 0.0
            # What the policy saw is what stood there, also just after a reset.
            np.testing.assert_allclose(goals[t, n], state.obs["goal"], atol=1e-3)
            off = np.abs(depths[t, n] - state.obs["depth"]) > 1e-2
            assert off.mean() < 0.03  # a float32 heading may look past a wall's edge
            state = step(state, actions[t, n])
            total += float(state.reward)
            if state.done:
                metrics = {name: float(value) for name, value in state.metrics.items()}
                log.append((config, total, int(state.pipeline_state.step_count), metrics, t))
                state = None
        logs.append(log)
    return logs


def joined(batches):
    """(config, done, failed, return, length) over all batches, each (T, B)."""
    endings = [(*e.outcomes, e.returns, e.lengths) for _, _, e in batches]
    return [np.concatenate(field) for field in zip(*endings, strict=True)]


def test_every_episode_counts_once_when_it_ends_for_its_own_configuration(batches, refly):
    config, done, failed, returns, lengths = joined(batches)
    kinds = set()
    for n, log in enumerate(refly):
        ends = np.flatnonzero(done[:, n])
        assert ends.tolist() == [last for *_, last in log]
        for end, (of, total, steps, metrics, _) in zip(ends, log, strict=True):
            assert config[end, n] == of
            assert failed[end, n] == (metrics["goal"] == 0)
            assert lengths[end, n] == steps
            np.testing.assert_allclose(returns[end, n], total, rtol=1e-6)
            kinds.add(next(name for name, value in metrics.items() if value))
    assert kinds == {"goal", "collision", "timeout"}


def test_unfinished_episodes_are_carried_into_the_next_batch(batches):
    _, done, _, _, lengths = joined(batches)
    ends = np.argwhere(done.T)
    crossing = 0
    for n in range(NUM_ENVS):
        begin = 0
        for end in ends[ends[:, 0] == n, 1]:
            assert lengths[end, n] == end + 1 - begin
            crossing += begin // NUM_STEPS != end // NUM_STEPS
            begin = end + 1
    assert crossing > 3
    # 17 steps are more than a batch has: no time-out could be seen if batches began anew.
    assert lengths[done.astype(bool)].max() == 17 > NUM_STEPS


def test_nothing_unfinished_fails(batches):
    _, done, failed, _, _ = joined(batches)
    assert not np.any(failed & ~done)


def test_rewards_and_endings_of_the_trajectory_add_up(batches):
    for fleet, trajectory, episodes in batches:
        running = np.array(fleet.episode_return)
        for t in range(NUM_STEPS):
            running += np.asarray(trajectory.reward[t])
            done = np.asarray(trajectory.done[t], bool)
            np.testing.assert_array_equal(done, episodes.outcomes.done[t])
            np.testing.assert_allclose(running[done], np.asarray(episodes.returns[t])[done], rtol=1e-6)
            running[done] = 0


def test_what_the_sampler_learns_is_what_was_flown(batches, refly):
    state = pec(3).init()
    for _, _, episodes in batches:
        state = pec(3).update(state, episodes.outcomes)
    expected = np.zeros((2, 3), int)
    for log in refly:
        for config, _, _, metrics, _ in log:
            expected[:, config] += (1, metrics["goal"] == 0)
    np.testing.assert_array_equal(state.counts, expected)


def part(tree, ids, axis):
    return jax.tree.map(lambda leaf: jnp.take(leaf, jnp.asarray(ids), axis=axis), tree)


def assert_same(one, other):
    """Equal choices and endings; float32 numbers as far as another batch size rounds them otherwise."""

    def compare(a, b):
        if jnp.issubdtype(a.dtype, jnp.floating):
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-4)
        else:
            np.testing.assert_array_equal(a, b)

    jax.tree.map(compare, one, other)


def test_the_split_over_devices_changes_nothing(roll, first, batches):
    mesh = Mesh(np.array(jax.devices()[:2]), ("devices",))
    whole, ours, by_time = PartitionSpec(), PartitionSpec("devices"), PartitionSpec(None, "devices")
    sharded = jax.jit(
        jax.shard_map(
            roll, mesh=mesh, in_specs=(whole, ours, whole, ours), out_specs=(ours, by_time, by_time),
            check_vma=False,
        )
    )  # fmt: skip
    fleet, trajectory, episodes = sharded(pec(3).init(), first, jax.random.key(0), jnp.arange(NUM_ENVS))
    _, expected, expected_episodes = batches[0]

    def keep(t, e):
        return t.action, t.reward, t.done, t.obs["goal"], e

    assert_same(keep(trajectory, episodes), keep(expected, expected_episodes))
    np.testing.assert_array_equal(fleet.config_id, batches[1][0].config_id)


def test_environments_go_by_their_global_number(roll, first, batches):
    order = np.array([4, 2, 0, 5, 1, 3])
    fleet, trajectory, episodes = jax.jit(roll)(
        pec(3).init(), part(first, order, 0), jax.random.key(0), jnp.asarray(order)
    )
    _, expected, expected_episodes = batches[0]
    assert_same(trajectory.action, part(expected.action, order, 1))
    assert_same(episodes, part(expected_episodes, order, 1))
    assert_same(fleet.config_id, part(batches[1][0].config_id, order, 0))


def test_resets_draw_from_the_sampler(scene, monkeypatch):
    # Thousands of episodes, each of one step, however that is flown.
    monkeypatch.setattr(navigation, "fly", glide)
    quick = pecjax.RoomsNavigation(scene, TABLE, pecjax.NavigationSettings(max_steps=1))
    sampler, num_envs = pec(3, alpha=0.2), 64
    failed = [False] * 10 + [True] * 3 + [False] * 7 + [True] * 9 + [False]
    outcomes = Outcomes(jnp.repeat(jnp.arange(3), 10), jnp.ones(30), jnp.array(failed))
    state = sampler.update(sampler.init(), outcomes)
    fleet = init_rollout(quick, TABLE, sampler, state, jax.random.key(1), num_envs)
    fly = jax.jit(lambda *args: rollout(quick, TABLE, sampler, state, act, *args, num_steps=64))
    _, trajectory, episodes = fly(fleet, jax.random.key(2), jnp.arange(num_envs))
    assert np.all(episodes.outcomes.done)
    ids = np.asarray(episodes.outcomes.config_id)
    drawn = np.bincount(ids.ravel(), minlength=3)
    assert stats.chisquare(drawn, ids.size * np.array([0.2, 0.5, 1.1]) / 1.8).pvalue > 1e-3
    # One draw says nothing about the next one of the same environment, nor about its neighbour's.
    for one, other in ((ids[:-1], ids[1:]), (ids[:, :-1], ids[:, 1:])):
        pairs = np.histogram2d(one.ravel(), other.ravel(), bins=3)[0]
        assert stats.chi2_contingency(pairs).pvalue > 1e-3
    # And the episode is flown in the configuration it is counted for, from any heading.
    distances = np.linalg.norm(TABLE.goal - TABLE.start, axis=1)
    np.testing.assert_allclose(trajectory.obs["goal"][..., 0], distances[ids], rtol=1e-5)
    bearings = np.asarray(trajectory.obs["goal"][..., 1]).ravel()
    assert stats.kstest(bearings, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3


def test_launch_starts_at_zero(first):
    assert isinstance(first, RolloutState)
    np.testing.assert_array_equal(first.episode_return, np.zeros(NUM_ENVS))
    np.testing.assert_array_equal(first.state.pipeline_state.step_count, np.zeros(NUM_ENVS))
    np.testing.assert_array_equal(first.state.pipeline_state.qpos[:, :2], TABLE.start[first.config_id])
