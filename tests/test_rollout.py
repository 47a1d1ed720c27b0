"""Rollouts against plain loops over a task's steps."""

from typing import NamedTuple

import jax
import numpy as np
import pytest
from conftest import glide
from jax import numpy as jnp
from jax.sharding import Mesh, PartitionSpec
from probe_tasks import Numbers
from scipy import stats

import pecjax
from pecjax.agents.episodes import sum_over_episodes
from pecjax.agents.rollout import Policy, RolloutState, init_rollout, rollout
from pecjax.curriculum import Outcomes, pec, uniform
from pecjax.envs.axes import fill
from pecjax.envs.rooms import task as rooms_task
from pecjax.envs.rooms.sensing import DISTANCE_SCALE
from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, Transition, World, take_configs

NUM_ENVS, NUM_STEPS, NUM_BATCHES = 6, 14, 3
# A goal close by, a wall close by, and a goal out of reach: every ending within a few steps.
TABLE = fill(
    pecjax.Configurations(
        start=np.float32([(0, -2), (7.4, -2), (3, 3)]), goal=np.float32([(0.6, -2), (0, -2), (5, 6)])
    )
)


def anything(seen, chance):
    """Any action, whatever is seen."""
    return (chance * 15).astype(jnp.int32), None, chance


def no_value(seen):
    raise AssertionError("what a task that never truncates is never asked")


ANYTHING = Policy(jax.random.uniform, anything, no_value)


def task_and_world(scene, max_steps):
    env = pecjax.RoomsNavigation(scene, TABLE, pecjax.NavigationSettings(max_steps=max_steps))
    return env.task, World(env.params, env.configurations)


@pytest.fixture(scope="module")
def rooms(scene):
    return task_and_world(scene, max_steps=17)


@pytest.fixture(scope="module")
def roll(rooms):
    task, world = rooms

    def batch(state, envs, key, env_ids):
        return rollout(task, world, pec(3), state, ANYTHING, envs, key, env_ids, NUM_STEPS)

    return batch


@pytest.fixture(scope="module")
def first(rooms):
    return init_rollout(*rooms, pec(3), pec(3).init(), jax.random.key(0), NUM_ENVS)


@pytest.fixture(scope="module")
def batches(roll, first):
    """(environments before, trajectory, episodes) of successive batches of the same environments."""
    envs, fly = first, jax.jit(roll)
    flown = []
    for n in range(NUM_BATCHES):
        after, trajectory, episodes = fly(pec(3).init(), envs, jax.random.key(n), jnp.arange(NUM_ENVS))
        flown.append((envs, trajectory, episodes))
        envs = after
    return flown


def goals_seen(obs):
    """Distance (m) and bearing (rad)."""
    distance, sine, cosine = np.moveaxis(np.asarray(obs["goal"]), -1, 0)
    return distance * DISTANCE_SCALE, np.arctan2(sine, cosine)


@pytest.fixture(scope="module")
def refly(rooms, batches):
    """Per environment, its episodes by `Task.step`, as (config, return, steps, endings, last step).

    Only observations and actions are taken from the rollout: where an episode starts, the bearing
    of the goal tells the heading.
    """
    task, world = rooms
    key = jax.random.key(0)  # of which nothing depends in these
    step = jax.jit(lambda state, action: task.step(key, state, action, world.params))
    look = jax.jit(lambda state: task.observe(key, state, world.params))
    actions = np.concatenate([t.action for _, t, _ in batches])
    goals = np.concatenate([t.obs["goal"] for _, t, _ in batches])
    depths = np.concatenate([t.obs["depth"] for _, t, _ in batches])
    far, bearings = goals_seen({"goal": goals})
    distances = np.linalg.norm(TABLE.goal - TABLE.start, axis=1)
    logs = []
    for n in range(NUM_ENVS):
        log, state = [], None
        for t in range(len(actions)):
            if state is None:
                config = int(np.argmin(np.abs(distances - far[t, n])))
                offset = TABLE.goal[config] - TABLE.start[config]
                heading = np.float32(np.arctan2(offset[1], offset[0]) - bearings[t, n])
                state = task.place(take_configs(TABLE, config), heading)
                total, steps, length = 0.0, 0, 0.0
            # What the policy saw is what stood there, also just after a reset.
            seen = look(state)
            np.testing.assert_allclose(goals[t, n], seen["goal"], atol=1e-4)
            off = np.abs(depths[t, n] - seen["depth"]) > 1e-3
            assert off.mean() < 0.03  # a float32 heading may look past a wall's edge
            after = step(state, actions[t, n])
            length += float(np.linalg.norm(after.state.qpos[:2] - state.qpos[:2]))
            state, steps = after.state, steps + 1
            total += float(after.reward)
            assert not after.truncated
            if after.terminated:
                endings = {name: float(value) for name, value in after.metrics.items()}
                endings |= {"goal": float(after.success), "path_length": length}
                log.append((config, total, steps, endings, t))
                state = None
        logs.append(log)
    return logs


def joined(batches):
    """(config, done, failed, length, return) over all batches, each (T, B)."""
    endings = [e.outcomes[:5] for _, _, e in batches]
    return [np.concatenate(field) for field in zip(*endings, strict=True)]


def test_every_episode_counts_once_when_it_ends_for_its_own_configuration(batches, refly):
    config, done, failed, lengths, returns = joined(batches)
    reported = {
        name: np.concatenate([e.metrics[name] for *_, e in batches]) for name in batches[0][2].metrics
    }
    assert set(reported) == {"collision", "timeout", "unstable", "path_length"}
    kinds = set()
    for n, log in enumerate(refly):
        ends = np.flatnonzero(done[:, n])
        assert ends.tolist() == [last for *_, last in log]
        for end, (of, total, steps, endings, _) in zip(ends, log, strict=True):
            assert config[end, n] == of
            assert failed[end, n] == (endings["goal"] == 0)
            assert lengths[end, n] == steps
            np.testing.assert_allclose(returns[end, n], total, rtol=1e-6)
            for name, of_all in reported.items():
                # The drone flown again is elsewhere by what float32 rounds off.
                assert abs(of_all[end, n] - endings[name]) <= (1e-3 if name == "path_length" else 0)
            kinds |= {name for name in ("goal", "collision", "timeout") if endings[name]}
    assert kinds == {"goal", "collision", "timeout"}


def test_unfinished_episodes_are_carried_into_the_next_batch(batches):
    _, done, _, lengths, _ = joined(batches)
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
    for envs, trajectory, episodes in batches:
        running = np.array(envs.running.episode_return)
        for t in range(NUM_STEPS):
            running += np.asarray(trajectory.reward[t])
            done = np.asarray(trajectory.done[t], bool)
            np.testing.assert_array_equal(done, episodes.outcomes.done[t])
            returns = np.asarray(episodes.outcomes.episode_return[t])
            np.testing.assert_allclose(running[done], returns[done], rtol=1e-6)
            running[done] = 0


def test_what_the_sampler_learns_is_what_was_flown(batches, refly):
    state = pec(3).init()
    for _, _, episodes in batches:
        state = pec(3).update(state, episodes.outcomes)
    expected = np.zeros((2, 3), int)
    for log in refly:
        for config, _, _, endings, _ in log:
            expected[:, config] += (1, endings["goal"] == 0)
    np.testing.assert_array_equal(state.statistics, expected)


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
    envs, trajectory, episodes = sharded(pec(3).init(), first, jax.random.key(0), jnp.arange(NUM_ENVS))
    _, expected, expected_episodes = batches[0]

    def keep(t, e):
        return t.action, t.reward, t.done, t.obs["goal"], e

    assert_same(keep(trajectory, episodes), keep(expected, expected_episodes))
    np.testing.assert_array_equal(envs.running.config_id, batches[1][0].running.config_id)


def test_environments_go_by_their_global_number(roll, first, batches):
    order = np.array([4, 2, 0, 5, 1, 3])
    envs, trajectory, episodes = jax.jit(roll)(
        pec(3).init(), part(first, order, 0), jax.random.key(0), jnp.asarray(order)
    )
    _, expected, expected_episodes = batches[0]
    assert_same(trajectory.action, part(expected.action, order, 1))
    assert_same(episodes, part(expected_episodes, order, 1))
    assert_same(envs.running, part(batches[1][0].running, order, 0))


def test_resets_draw_from_the_sampler(scene, monkeypatch):
    # Thousands of episodes, each of one step, however that is flown.
    monkeypatch.setattr(rooms_task, "fly", glide)
    task, world = task_and_world(scene, max_steps=1)
    sampler, num_envs = pec(3, alpha=0.2), 64
    failed = [False] * 10 + [True] * 3 + [False] * 7 + [True] * 9 + [False]
    outcomes = Outcomes(jnp.repeat(jnp.arange(3), 10), jnp.ones(30), jnp.array(failed))
    state = sampler.update(sampler.init(), outcomes)
    envs = init_rollout(task, world, sampler, state, jax.random.key(1), num_envs)
    fly = jax.jit(lambda *args: rollout(task, world, sampler, state, ANYTHING, *args, num_steps=64))
    _, trajectory, episodes = fly(envs, jax.random.key(2), jnp.arange(num_envs))
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
    seen, bearings = goals_seen(trajectory.obs)
    np.testing.assert_allclose(seen, distances[ids], rtol=1e-5)
    assert stats.kstest(bearings.ravel(), stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3


def test_launch_starts_at_zero(first):
    assert isinstance(first, RolloutState)
    np.testing.assert_array_equal(first.running.episode_return, np.zeros(NUM_ENVS))
    np.testing.assert_array_equal(first.running.length, np.zeros(NUM_ENVS))
    np.testing.assert_array_equal(first.state.step_count, np.zeros(NUM_ENVS))
    np.testing.assert_array_equal(first.state.qpos[:, :2], TABLE.start[first.running.config_id])


class Walker(NamedTuple):
    place: jax.Array
    steps: jax.Array
    config: Numbers


class Walk(Task):
    """A step up or down, from the configuration's number. Three away it ends; after 7 steps it is cut off.

    At the bottom it has failed. The same figure is reported in every way that there is, and another
    one that is a flag.
    """

    observation_space = Box((1,))
    action_space = Discrete(2)
    max_steps = 7
    truncates = True
    metrics = {how: how for how in ("sum", "mean", "min", "max", "last")} | {"down": "mean"}

    def reset(self, key, config, params):
        return Walker(config.number, jnp.zeros((), jnp.int32), config)

    def step(self, key, state, action, params):
        place, steps = state.place + params * (2 * action - 1), state.steps + 1
        terminated = jnp.abs(place - state.config.number) >= 3 * params
        figures = dict.fromkeys(("sum", "mean", "min", "max", "last"), 10 * place + steps)
        return Transition(
            state._replace(place=place, steps=steps),
            jnp.float32(place),
            terminated,
            steps >= self.max_steps,  # true also where it has just ended
            place > state.config.number,
            figures | {"down": action == 0},
        )

    def observe(self, key, state, params):
        return state.place[None]


WALK = World(jnp.float32(0.5), Numbers(np.float32([-4, 1, 6])))


@pytest.fixture(scope="module")
def walks():
    """Successive batches of walks, shorter than a walk may be: (trajectory, episodes)."""
    policy = Policy(
        lambda key: jax.random.bernoulli(key, 0.6).astype(jnp.int32),
        lambda seen, noise: (noise, None, ()),
        lambda seen: 1000 + seen.obs[:, 0],
    )
    task, sampler, envs = Walk(), uniform(3), None
    envs = init_rollout(task, WALK, sampler, sampler.init(), jax.random.key(0), 16)
    walk = jax.jit(
        lambda envs, key: rollout(task, WALK, sampler, sampler.init(), policy, envs, key, jnp.arange(16), 5)
    )
    started, batches = envs, []
    for n in range(12):
        envs, *batch = walk(envs, jax.random.key(n))
        batches.append(batch)
    return started, jax.tree.map(lambda *parts: np.concatenate(parts), *batches)


@pytest.mark.parametrize("stretch", [None, 5, 3, 1])
def test_a_memory_is_of_its_episode_and_kept_before_each_stretch(stretch):
    """A memory that counts its episode's steps; values at a cut are of the memory after the last step."""
    task, sampler = Walk(), uniform(3)
    policy = Policy(
        lambda key: jax.random.bernoulli(key, 0.6).astype(jnp.int32),
        lambda seen, noise: (noise, seen.memory + 1, seen.memory[:, 0]),
        lambda seen: 1000 + seen.memory[:, 0],
        jnp.zeros(1),
    )
    envs = init_rollout(task, WALK, sampler, sampler.init(), jax.random.key(0), 16, policy.first_memory)

    def walk(envs, stretch):
        key = jax.random.key(1)
        return rollout(task, WALK, sampler, sampler.init(), policy, envs, key, jnp.arange(16), 15, stretch)

    after, trajectory, episodes = jax.jit(walk, static_argnums=1)(envs, stretch)
    begun, ended = np.zeros(16), np.asarray(trajectory.done) == 1
    for counted, done in zip(np.asarray(trajectory.extras), ended, strict=True):
        np.testing.assert_array_equal(counted, begun)
        begun = np.where(done, 0, begun + 1)
    np.testing.assert_array_equal(after.memory[:, 0], begun)
    np.testing.assert_array_equal(trajectory.memory[..., 0], trajectory.extras[:: stretch or 15])
    cut = np.asarray(trajectory.bootstrap) != 0
    assert 0 < cut.sum() < ended.sum()
    np.testing.assert_array_equal(trajectory.bootstrap[cut], 1001 + trajectory.extras[cut])
    whole = jax.jit(walk, static_argnums=1)(envs, None)
    others = after, trajectory._replace(memory=None), episodes
    jax.tree.map(np.testing.assert_array_equal, others, (whole[0], whole[1]._replace(memory=None), whole[2]))


def test_metrics_lengths_and_returns_are_those_of_a_plain_loop(walks):
    started, (trajectory, episodes) = walks
    outcomes, ends = episodes.outcomes, {"bottom": 0, "top": 0, "cut up": 0, "cut down": 0}
    reduce = {"sum": sum, "mean": np.mean, "min": min, "max": max, "last": lambda figures: figures[-1]}
    for n in range(16):
        number = WALK.table.number[started.running.config_id[n]]
        place, rewards, figures, downs = number, [], [], []
        for t in range(len(trajectory.action)):
            assert trajectory.obs[t, n, 0] == place
            if not rewards:  # the configuration tells where it begins
                number = place
            action = trajectory.action[t, n]
            place += 0.5 * (2 * action - 1)
            rewards.append(place)
            figures.append(10 * place + len(rewards))
            downs.append(action == 0)
            ended, is_cut = abs(place - number) >= 1.5, len(rewards) == 7
            assert outcomes.done[t, n] == trajectory.done[t, n] == (ended or is_cut)
            assert outcomes.failed[t, n] == ((ended or is_cut) and place <= number)
            assert trajectory.reward[t, n] == place
            # The value is that of where it was cut off, and not of where the next one begins.
            assert trajectory.bootstrap[t, n] == (1000 + place if is_cut and not ended else 0)
            if not (ended or is_cut):
                continue
            assert WALK.table.number[outcomes.config_id[t, n]] == number
            assert outcomes.length[t, n] == len(rewards)
            np.testing.assert_allclose(outcomes.episode_return[t, n], sum(rewards), rtol=1e-6)
            for how, of in reduce.items():
                np.testing.assert_allclose(episodes.metrics[how][t, n], of(figures), rtol=1e-6, err_msg=how)
            np.testing.assert_allclose(episodes.metrics["down"][t, n], np.mean(downs), rtol=1e-6)
            up = "up" if place > number else "down"
            ends[f"cut {up}" if not ended else {"up": "top", "down": "bottom"}[up]] += 1
            rewards, figures, downs = [], [], []
            if t + 1 < len(trajectory.action):
                place = trajectory.obs[t + 1, n, 0]
    assert min(ends.values()) > 5


def test_walks_begin_in_all_configurations_and_are_carried_on(walks):
    _, (_, episodes) = walks
    done = episodes.outcomes.done
    assert set(np.unique(episodes.outcomes.config_id[done])) == {0, 1, 2}
    started_before = np.argwhere(done)[:, 0] % 5 + 1 < episodes.outcomes.length[done]
    assert started_before.sum() > 20
    assert episodes.outcomes.signal is None


def test_scores_are_summed_over_episodes_and_across_batches():
    draw = np.random.default_rng(0)
    scores, done = draw.normal(size=(30, 4)), draw.random((30, 4)) < 0.2
    expected, total = np.zeros((30, 4)), np.zeros(4)
    for t in range(30):
        total = total + scores[t]
        expected[t] = total
        total = np.where(done[t], 0, total)
    before, found = jnp.zeros(4), []
    for part in (slice(0, 7), slice(7, 30)):
        sums, before = sum_over_episodes(before, jnp.asarray(scores[part]), jnp.asarray(done[part]))
        found.append(sums)
    np.testing.assert_allclose(np.concatenate(found), expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(before, total, rtol=1e-5, atol=1e-6)
