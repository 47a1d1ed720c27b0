"""Settings of a run: one tree of task, sampler, agent, evaluation and end."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from pecjax import settings_tree
from pecjax.agents import PPO, AgentSettings
from pecjax.curriculum import PEC, SamplerSettings
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.task import TaskSettings
from pecjax.errors import InputError
from pecjax.training.kinds import kind_name, make_kind
from pecjax.training.limits import check_limits

# Settings that have short names.
SHORT = {
    "alpha": "sampler.alpha",
    "coordinates": "task.table",
    "scene": "task.maps",
    "seed": "seed",
    "iterations": "stop.iterations",
    "until_goal_ratio": "stop.until_goal_ratio",
    "patience": "stop.patience",
    "evaluate_every": "evaluation.every",
    "greedy": "evaluation.greedy",
}


@dataclass(frozen=True)
class EvaluationSettings:
    """How policies are evaluated.

    Attributes:
        every: iterations between evaluations; each saves a checkpoint.
        episodes: episodes of an evaluation, spread evenly over the configurations.
        seed: the same for all runs, so that they are paired.
        greedy: whether evaluations take the most likely action; otherwise they draw, as training does.
    """

    every: int = 50
    episodes: int = 200
    seed: int = 2022
    greedy: bool = True


@dataclass(frozen=True)
class StopSettings:
    """When a training ends. The iterations themselves do not depend on it.

    Attributes:
        iterations: the most iterations to train for.
        until_goal_ratio: stops once `patience` iterations in a row have reached this training goal ratio;
            None to train to the end.
        patience: iterations in a row, for `until_goal_ratio`.
    """

    iterations: int = 457
    until_goal_ratio: float | None = None
    patience: int = 5


@dataclass(frozen=True)
class RunSettings:
    """Everything that a run depends on, except the content of the files that its task reads.

    Attributes:
        preset: name of the preset that these settings started from.
        task: what is learned, and in which configurations.
        sampler: how the next configuration is chosen.
        agent: the learner.
        evaluation: how it is evaluated.
        stop: when it ends.
        seed: for everything random in training.
        configurations_every: iterations between files in `configurations/`.
    """

    preset: str = "fast"
    task: TaskSettings = Rooms()
    sampler: SamplerSettings = PEC()
    agent: AgentSettings = PPO()
    evaluation: EvaluationSettings = EvaluationSettings()
    stop: StopSettings = StopSettings()
    seed: int = 0
    configurations_every: int = 10


def check_settings(settings: RunSettings) -> None:
    """Makes sure that the settings can be run, as far as they tell without the task.

    Raises:
        InputError: the first setting that cannot.
    """
    counts = {
        "iterations": settings.stop.iterations,
        "num-envs": settings.agent.num_envs,
        "patience": settings.stop.patience,
        "evaluation.every": settings.evaluation.every,
        "evaluation.episodes": settings.evaluation.episodes,
        "configurations-every": settings.configurations_every,
    }
    for name, value in counts.items():
        if value < 1:
            raise InputError(f"{name} is {value}; it must be at least 1")
    goal_ratio = settings.stop.until_goal_ratio
    if goal_ratio is not None and not 0 < goal_ratio <= 1:
        raise InputError(f"until-goal-ratio is {goal_ratio}; it must lie above 0 and be at most 1")
    for seed in (settings.seed, settings.evaluation.seed):
        if not 0 <= seed < 2**31:
            raise InputError(f"seed is {seed}; it must lie in 0 to 2147483647")
    check_limits(settings)
    settings.agent.check()


def override(
    settings: RunSettings,
    *,
    task: str | None = None,
    sampler: str | None = None,
    agent: str | None = None,
    num_envs: int | None = None,
    **changes: Any,
) -> RunSettings:
    """The settings with every change that is not None.

    Args:
        task, sampler, agent: names of kinds; where it is that of what there is, its numbers stay.
        changes: by the names in `SHORT`.

    Raises:
        InputError: no such kind, or a setting that it does not have.
    """
    for slot, name in {"task": task, "sampler": sampler, "agent": agent}.items():
        if name is not None:
            kind = make_kind(slot, name, getattr(settings, slot))
            settings = dataclasses.replace(settings, **{slot: kind})
    if num_envs is not None:
        settings = dataclasses.replace(settings, agent=settings.agent.with_envs(num_envs))
    for name, value in changes.items():
        if value is None:
            continue
        slot, _, leaf = SHORT[name].rpartition(".")
        part: Any = getattr(settings, slot) if slot else settings
        if leaf not in [field.name for field in dataclasses.fields(part)]:
            option = name.replace("_", "-")
            raise InputError(f"the {slot} {kind_name(part)} has no {leaf}; leave out --{option}")
        settings = settings_tree.set_path(settings, SHORT[name], value)
    return settings
