"""Every task keeps the contract: those that tests are made of, and the rooms."""

import jax
import numpy as np
import pytest
from contract_task import check_task
from probe_tasks import TARGET_WORLD, WORLD, CutOff, Target, TwoStates

import pecjax
from pecjax.envs.spaces import Box
from pecjax.envs.task import num_configs, take_configs


@pytest.mark.parametrize(
    ("task", "world"), [(TwoStates(), WORLD), (CutOff(), WORLD), (Target(), TARGET_WORLD)]
)
def test_probe_tasks_keep_the_contract(task, world):
    assert check_task(task, world) > 6


def test_the_rooms_keep_the_contract(gliding):
    task, world = pecjax.Rooms(max_steps=30).make()
    assert task.max_steps == 30 and not task.truncates
    assert check_task(task, world) >= 6  # each was out of steps by then


def test_a_world_of_several_configurations_is_taken_apart_row_by_row():
    assert num_configs(WORLD.table) == 3
    np.testing.assert_array_equal(take_configs(WORLD.table, np.array([2, 0])).number, [2, 0])
    assert take_configs(WORLD.table, 1).number.shape == ()


class Grows(CutOff):
    """Keeps its steps as another type than it began with."""

    def step(self, key, state, action, params):
        after = super().step(key, state, action, params)
        return after._replace(state=after.state._replace(steps=after.state.steps * 1.0))


class Silent(CutOff):
    """Truncates, and does not say so."""

    truncates = False


class Outside(TwoStates):
    """Sees what its space has no room for."""

    observation_space = Box((2,), 0.0, 0.5)


class Endless(CutOff):
    """Goes on for longer than it says."""

    max_steps = 3

    def step(self, key, state, action, params):
        after = super().step(key, state, action, params)
        return after._replace(truncated=after.state.steps >= 5)


class Talkative(TwoStates):
    """Reports what it has not named."""

    def step(self, key, state, action, params):
        after = super().step(key, state, action, params)
        return after._replace(metrics={"unnamed": after.reward})


class Fickle(TwoStates):
    """Draws from what is not its key."""

    draws = np.random.default_rng(0)

    def reset(self, key, config, params):
        other = jax.random.fold_in(key, int(self.draws.integers(1000)))
        return super().reset(other, config, params)


@pytest.mark.parametrize("broken", [Grows, Silent, Outside, Endless, Talkative, Fickle])
def test_a_task_that_breaks_the_contract_is_found_out(broken):
    with pytest.raises(AssertionError):
        check_task(broken(), WORLD)
