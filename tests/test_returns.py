"""Advantages against rlax and against the linear filter that RLlib computes them with."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rlax
from scipy.signal import lfilter

from pecjax.agents.returns import (
    generalized_advantage,
    maximised_negative_advantage,
    n_step_return,
    td_errors,
    with_bootstrap,
)

STEPS, ENVS = 37, 5


def batch(seed: int, done_ratio: float):
    draw = np.random.default_rng(seed)
    rewards = draw.normal(0, 100, (STEPS, ENVS)).astype(np.float32)
    values = draw.normal(0, 50, (STEPS + 1, ENVS)).astype(np.float32)
    dones = (draw.random((STEPS, ENVS)) < done_ratio).astype(np.float32)
    return rewards, values, dones


def of_rlax(rewards, values, dones, discount, gae_lambda):
    one_env = rlax.truncated_generalized_advantage_estimation
    return jax.vmap(one_env, in_axes=(1, 1, None, 1), out_axes=1)(
        jnp.asarray(rewards), jnp.asarray(discount * (1 - dones)), gae_lambda, jnp.asarray(values)
    )


@pytest.mark.parametrize("ends", ["none", "inside", "last step", "every step"])
@pytest.mark.parametrize(("discount", "gae_lambda"), [(0.99, 0.95), (0.9, 1.0), (0.99, 0.0), (1.0, 0.5)])
def test_equals_rlax(ends, discount, gae_lambda):
    rewards, values, dones = batch(seed=1, done_ratio=0.15 if ends == "inside" else 0.0)
    if ends == "last step":
        dones[-1] = 1
    if ends == "every step":
        dones[:] = 1
    ours = generalized_advantage(rewards, values[:-1], dones, values[-1], discount, gae_lambda)
    theirs = of_rlax(rewards, values, dones, discount, gae_lambda)
    # Both are float32 recursions over numbers of size 1e3.
    np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-3)


def test_equals_the_filter_of_rllib_where_nothing_ends():
    rewards, values, dones = batch(seed=2, done_ratio=0.0)
    ours = generalized_advantage(rewards, values[:-1], dones, values[-1], 0.99, 0.95)
    deltas = rewards.astype(np.float64) + 0.99 * values[1:] - values[:-1]
    filtered = lfilter([1], [1, -0.99 * 0.95], deltas[::-1], axis=0)[::-1]
    np.testing.assert_allclose(ours, filtered, rtol=1e-5, atol=1e-3)


def test_an_ending_pays_its_reward_and_nothing_after_it():
    """A task's own step limit is an ending like any other: no value is bootstrapped over it."""
    rewards, values, dones = batch(seed=3, done_ratio=0.0)
    dones[10] = 1
    before = generalized_advantage(rewards, values[:-1], dones, values[-1], 0.99, 0.95)
    np.testing.assert_allclose(before[10], rewards[10] - values[10], rtol=1e-6)

    later_rewards, later_values = rewards.copy(), values.copy()
    later_rewards[11:] += 1e4
    later_values[11:] -= 1e4
    after = generalized_advantage(later_rewards, later_values[:-1], dones, later_values[-1], 0.99, 0.95)
    np.testing.assert_array_equal(before[:11], after[:11])
    assert np.all(before[11:] != after[11:])


def plain_mna(errors, dones, discount, gae_lambda):
    """By the code of Mead et al. 2026, read and written anew for one environment: a loop from every step."""
    found = np.zeros(len(errors))
    for start in range(len(errors)):
        lost = 0.0
        for age, error in enumerate(errors[start:]):
            lost = min(lost + discount**age * error, 0.0)
            is_over = dones[start + age] or start + age == len(errors) - 1
            share = gae_lambda**age if is_over else (1 - gae_lambda) * gae_lambda**age
            found[start] -= share * lost
            if is_over:
                break
    return found


@pytest.mark.parametrize("done_ratio", [0.0, 0.15, 1.0])
@pytest.mark.parametrize(("discount", "gae_lambda"), [(0.99, 0.95), (0.9, 1.0), (0.99, 0.0)])
def test_the_maximised_negative_advantage_is_that_of_its_authors(done_ratio, discount, gae_lambda):
    rewards, values, dones = batch(4, done_ratio)
    errors = td_errors(rewards, values[:-1], dones, values[-1], discount)
    ours = maximised_negative_advantage(errors, dones, discount, gae_lambda)
    theirs = [
        plain_mna(*rows, discount, gae_lambda) for rows in zip(np.float64(errors).T, dones.T, strict=True)
    ]
    np.testing.assert_allclose(ours, np.transpose(theirs), rtol=1e-5, atol=1e-3)
    advantage = generalized_advantage(rewards, values[:-1], dones, values[-1], discount, gae_lambda)
    assert (ours >= -advantage - 1e-3).all()


def test_where_all_is_lost_it_is_the_advantage_taken_negative():
    rewards, values, dones = batch(5, 0.1)
    rewards -= 1000
    errors = td_errors(rewards, values[:-1], dones, values[-1], 0.99)
    ours = maximised_negative_advantage(errors, dones, 0.99, 0.95)
    advantage = generalized_advantage(rewards, values[:-1], dones, values[-1], 0.99, 0.95)
    np.testing.assert_allclose(ours, -advantage, rtol=1e-4)


def test_the_step_limit_of_the_rooms_is_such_an_ending(env):
    """One step before the limit, in the open, standing still: terminated, and a failure."""
    config = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], env.configurations)
    state = env.task.place(config, jnp.zeros(()))
    counted = state._replace(step_count=jnp.int32(env.task.settings.max_steps - 1))
    last = jax.jit(env.task.step)(jax.random.key(0), counted, jnp.int32(2), env.params)
    assert (last.terminated, last.truncated, last.metrics["timeout"], last.success) == (1, 0, 1, 0)
    value = np.float32(123.0)
    advantage = generalized_advantage(
        last.reward[None, None],
        jnp.full((1, 1), value),
        jnp.float32(last.terminated | last.truncated)[None, None],
        jnp.full(1, 1e6),  # would show if it were bootstrapped
        0.99,
        0.95,
    )
    np.testing.assert_allclose(advantage[0, 0], -1001 - value)


def cut_batch(seed: int, done_ratio: float = 0.2):
    """rewards, values, dones, and the values `bootstrap` beyond those endings that are cuts."""
    rewards, values, dones = batch(seed, done_ratio)
    draw = np.random.default_rng(seed + 100)
    cut = (dones == 1) & (draw.random(dones.shape) < 0.5)
    bootstrap = np.where(cut, draw.normal(0, 50, dones.shape), 0).astype(np.float32)
    assert cut.sum() > 5 and (dones - cut).sum() > 5
    return rewards, values, dones, bootstrap


def episode_by_episode(rewards, values, dones, bootstrap, discount, gae_lambda):
    """rlax's estimates of each episode by itself, its last value being what lies beyond its end."""
    result = np.zeros_like(rewards)
    for env in range(rewards.shape[1]):
        ends = [*np.flatnonzero(dones[:, env]), len(rewards) - 1]
        first = 0
        for end in ends:
            part = slice(first, end + 1)
            steps, first = end + 1 - first, end + 1
            if steps == 0:  # the last step was an ending
                continue
            beyond = bootstrap[end, env] if dones[end, env] else values[-1, env]
            result[part, env] = rlax.truncated_generalized_advantage_estimation(
                jnp.asarray(rewards[part, env]),
                jnp.full(steps, discount),
                gae_lambda,
                jnp.append(values[part, env], beyond),
            )
    return result


@pytest.mark.parametrize(("discount", "gae_lambda"), [(0.99, 0.95), (0.9, 1.0), (0.99, 0.0)])
def test_an_episode_that_is_cut_off_goes_on_in_the_value_beyond_the_cut(discount, gae_lambda):
    rewards, values, dones, bootstrap = cut_batch(seed=4)
    ours = generalized_advantage(
        with_bootstrap(rewards, bootstrap, discount), values[:-1], dones, values[-1], discount, gae_lambda
    )
    theirs = episode_by_episode(rewards, values, dones, bootstrap, discount, gae_lambda)
    np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-3)
    # What is bootstrapped matters, and within its own episode alone.
    without = generalized_advantage(rewards, values[:-1], dones, values[-1], discount, gae_lambda)
    differ = np.abs(ours - without) > 1e-2
    assert (differ[bootstrap != 0]).all()
    assert not differ[(dones == 1) & (bootstrap == 0)].any()


def test_nothing_is_added_where_a_task_never_cuts_off():
    rewards, _, _ = batch(seed=6, done_ratio=0.2)
    assert with_bootstrap(rewards, None, 0.9) is rewards
    np.testing.assert_array_equal(with_bootstrap(rewards, np.zeros_like(rewards), 0.9), rewards)


@pytest.mark.parametrize("number", [1, 3, 5])
def test_n_step_returns_end_in_the_value_beyond_a_cut(number):
    rewards, values, dones, bootstrap = cut_batch(seed=7)
    total, going_on = n_step_return(with_bootstrap(rewards, bootstrap, 0.9), dones, number, 0.9)
    ours = total + going_on * values[number:]
    for start in range(STEPS - number + 1):
        for env in range(ENVS):
            expected, factor = 0.0, 1.0
            for t in range(start, start + number):
                expected += factor * np.float64(rewards[t, env])
                factor *= 0.9
                if dones[t, env]:
                    expected += factor * np.float64(bootstrap[t, env])
                    break
            else:
                expected += factor * values[start + number, env]
            np.testing.assert_allclose(ours[start, env], expected, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("number", [1, 3, 5])
def test_n_step_returns_equal_rlax_with_endings_inside_the_window(number):
    rewards, values, dones = batch(seed=2, done_ratio=0.2)
    total, going_on = n_step_return(jnp.asarray(rewards), jnp.asarray(dones), number, 0.99)
    ahead = values[number:]  # of the observation after each window
    ours = total + going_on * ahead
    one_env = partial(rlax.n_step_bootstrapped_returns, n=number)
    theirs = jax.vmap(one_env, in_axes=1, out_axes=1)(
        jnp.asarray(rewards), jnp.asarray(0.99 * (1 - dones)), jnp.asarray(values[1:])
    )
    # Towards its end rlax bootstraps from shorter windows, which we do not have.
    np.testing.assert_allclose(ours, theirs[: len(ours)], rtol=1e-5, atol=1e-3)
    assert going_on.shape == (STEPS - number + 1, ENVS) and 0 < (going_on == 0).mean() < 1


@pytest.mark.parametrize(
    ("rewards", "dones", "last_value"), [((4,), (4, 4), (4,)), ((4, 4), (4, 1), (4,)), ((4, 4), (4, 4), (1,))]
)
def test_shapes_that_would_broadcast_are_a_fault(rewards, dones, last_value):
    with pytest.raises(AssertionError):
        td_errors(jnp.ones(rewards), jnp.ones((4, 4)), jnp.ones(dones), jnp.ones(last_value), 0.9)
