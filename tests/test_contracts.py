"""A task or a sampler of one's own that breaks its contract is told so in one line, before it is compiled."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from probe_tasks import TARGET_WORLD, Target, TwoStates

import pecjax
from pecjax.curriculum import PEC, SamplerSettings, pec
from pecjax.envs.spaces import Box
from pecjax.envs.task import World
from pecjax.training.build import build
from pecjax.training.contracts import check_sampler, check_task


class Changed(Target):
    """`Target`, but for one part of what it gives."""

    def __init__(self, **parts):
        self.parts = parts

    def step(self, key, state, action, params):
        after = super().step(key, state, action, params)
        return after._replace(**{name: change(after) for name, change in self.parts.items()})


class Blind(Target):
    observation_space = Box((3,))


class Boastful(Target):
    privileged_space = Box((2,))

    def privileged(self, state, params):
        return jnp.ones(1)


class Forgetful(Target):
    privileged_space = Box((2,))


class Named(Target):
    observation_space: ClassVar = {"seen": Box((1,))}


class Pair(Target):
    def step(self, key, state, action, params):
        return state, 1.0


class Endless(Target):
    max_steps = 0


@dataclass
class Bare(Target):
    """Without one of the three that a task must say."""

    missing: str

    def __getattribute__(self, name):
        if name == object.__getattribute__(self, "missing"):
            raise AttributeError(name)
        return object.__getattribute__(self, name)


class Median(Target):
    metrics: ClassVar = {"distance": "median"}


class Renamed(Target):
    metrics: ClassVar = {"length": "last", "cvar": "mean"}


@pytest.mark.parametrize("task", [Target(), TwoStates()])
def test_a_task_that_keeps_its_contract_passes(task):
    check_task(task, TARGET_WORLD)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Blind(), r"test_contracts:Blind: observe is \(1,\) where observation_space says \(3,\)"),
        (Boastful(), r"Boastful: privileged is \(1,\) where privileged_space says \(2,\)"),
        (Forgetful(), "Forgetful has a privileged_space; write `privileged`, too"),
        (Bare("max_steps"), "Bare: has no max_steps; set it"),
        (Bare("observation_space"), "Bare: has no observation_space; set it"),
        (Bare("action_space"), "Bare: has no action_space; set it"),
        (Endless(), "Endless: max_steps is 0; give a whole number of 1 or more"),
        (Named(), r"observe is a tree .* where observation_space says .*'seen'"),
        (Pair(), "step gives tuple; give a Transition"),
        (Renamed(), "Renamed: metrics has cvar, length, which every task has; rename it"),
        (Median(), r"metrics has \['median'\]; a metric is one of .*'mean'"),
        (
            Changed(reward=lambda after: jnp.int32(1)),
            r"reward is \(\) int32 where Transition says \(\) float32",
        ),
        (Changed(reward=lambda after: jnp.ones(1)), r"reward is \(1,\) float32 where Transition says \(\)"),
        (Changed(terminated=lambda after: 1.0 * after.terminated), r"terminated is \(\) float32 .* bool"),
        (Changed(success=lambda after: after.success[None]), r"success is \(1,\) bool"),
        (Changed(metrics=lambda after: {}), "the metrics of step is a tree .* where Task.metrics says"),
        (
            Changed(state=lambda after: after.state._replace(steps=jnp.float32(0))),
            r"the state after step\.steps is \(\) float32 where the state of reset says \(\) int32",
        ),
    ],
)
def test_a_task_that_breaks_its_contract_is_told_so(task, words):
    with pytest.raises(pecjax.InputError, match=words):
        check_task(task, TARGET_WORLD)


def test_a_table_of_several_lengths_is_told_so():
    table = {"start": np.zeros(3), "goal": np.zeros(4)}
    with pytest.raises(pecjax.InputError, match=r"leading axes \[\(3,\), \(4,\)\]"):
        check_task(Target(), World((), table))


@pytest.mark.parametrize(
    ("part", "function", "words"),
    [
        (
            "sample",
            lambda state, key, shape: jnp.zeros(shape),
            r"mine: sample is \(3,\) float32 .* \(3,\) int32",
        ),
        (
            "probabilities",
            lambda state: jnp.ones(4) / 4,
            r"probabilities is \(4,\) .* N configurations says \(5,\)",
        ),
        ("update", lambda state, outcomes: (state,), "the state after update is a tree"),
    ],
)
def test_a_sampler_that_breaks_its_contract_is_told_so(part, function, words):
    check_sampler(pec(5), "mine", 5)
    with pytest.raises(pecjax.InputError, match=words):
        check_sampler(pec(5)._replace(**{part: function}), "mine", 5)


@dataclass(frozen=True)
class BlindSettings(pecjax.TaskSettings):
    """Of a task that breaks its contract."""

    def make(self):
        return Blind(), TARGET_WORLD


@dataclass(frozen=True)
class TargetSettings(pecjax.TaskSettings):
    """Of a task that keeps it."""

    def make(self):
        return Target(), TARGET_WORLD


@dataclass(frozen=True)
class Halved(SamplerSettings):
    """Of a sampler that breaks its contract, within one of ours or alone."""

    def make(self, num_configs):
        return pec(num_configs)._replace(probabilities=lambda state: jnp.ones(1))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (pecjax.RunSettings(task=BlindSettings(), sampler=PEC()), "Blind: observe is"),
        (pecjax.RunSettings(task=TargetSettings(), sampler=Halved()), "Halved: probabilities is"),
    ],
)
def test_a_training_hears_of_it_before_anything_is_compiled(settings, words):
    with pytest.raises(pecjax.InputError, match=words):
        build(settings, 1)
