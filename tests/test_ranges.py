"""Ranges: numbers of settings that nothing can be learnt or flown with get one line."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import pecjax
from pecjax.agents import PPO, Apex
from pecjax.agents.episodes import count_on
from pecjax.envs.gymnax import GymnaxTask, survived
from pecjax.envs.rooms import Rooms
from pecjax.envs.rooms.controller import ControllerGains
from pecjax.ranges import check_ranges


@pytest.mark.parametrize("kind", [PPO, Apex])
@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("discount", 99.0, "discount is 99; give 0 to 1"),
        ("learning_rate", -1.0, "learning-rate is -1; give 0 or more"),
        ("learning_rate", math.nan, "learning-rate is nan; give 0 or more"),
        ("reward_scale", 0.0, "reward-scale is 0; give more than 0"),
        ("max_grad_norm", 0.0, "max-grad-norm is 0; give more than 0"),
        ("decay_steps", 0, "decay-steps is 0; give 1 or more"),
    ],
)
def test_numbers_of_agents_have_ranges(kind, name, value, words):
    kind().check()
    with pytest.raises(pecjax.InputError, match=words):
        replace(kind(), **{name: value}).check()


@pytest.mark.parametrize(
    ("agent", "words"),
    [
        (PPO(gae_lambda=2.0), "gae-lambda is 2; give 0 to 1"),
        (PPO(clip_epsilon=0.0), "clip-epsilon is 0; give more than 0"),
        (PPO(value_clip=-1.0), "value-clip is -1; give more than 0"),
        (Apex(epsilon=-0.1), "epsilon is -0.1; give 0 to 1"),
        (Apex(huber_delta=0.0), "huber-delta is 0; give more than 0"),
    ],
)
def test_each_agent_has_some_of_its_own(agent, words):
    with pytest.raises(pecjax.InputError, match=words):
        agent.check()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"max_steps": 0}, "max-steps is 0; give 1 or more"),
        ({"goal_radius": -1.0}, "goal-radius is -1; give more than 0"),
        ({"gains": ControllerGains(max_tilt=45.0)}, "max-tilt is 45; give more than 0, at most 1.5"),
        ({"gains": ControllerGains(velocity=-3.0)}, "velocity is -3; give 0 or more"),
    ],
)
def test_so_have_those_of_the_rooms(changes, words):
    with pytest.raises(pecjax.InputError, match=words):
        Rooms(**changes).make()


def test_ends_belong_to_a_range_and_none_is_in_any():
    check_ranges(PPO(discount=1.0, gae_lambda=0.0), {"discount": (0, 1), "gae_lambda": (0, 1)})
    check_ranges(PPO(max_grad_norm=None), {"max_grad_norm": (5, 6)})


def test_counts_stay_at_the_greatest_number_and_are_exact_before():
    most = 2**31 - 1
    counts = jnp.array([0, 5, most - 3, most - 2, most], jnp.int32)
    np.testing.assert_array_equal(count_on(counts, jnp.int32([7, 0, 2, 7, 1])), [7, 5, most - 1, most, most])


class Bounded:
    """As much of an environment of gymnax as its spaces."""

    def __init__(self, low, high):
        self.space = type("Space", (), {"shape": (2,), "low": np.float32(low), "high": np.float32(high)})

    def observation_space(self, params):
        return self.space

    action_space = observation_space


def test_actions_have_one_pair_of_bounds():
    params = type("Params", (), {"max_steps_in_episode": 5})
    task = GymnaxTask(Bounded([-1, -1], [2, 2]), params, survived)
    assert (task.action_space.low, task.action_space.high) == (-1, 2)
    with pytest.raises(pecjax.InputError, match="all numbers of an action must have the same"):
        GymnaxTask(Bounded([0, -1], [2, 2]), params, survived)
