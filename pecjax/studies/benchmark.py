"""The benchmark of samplers: a study for each space, by the protocol of docs/benchmark.md."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from pecjax.agents import PPO, Apex
from pecjax.agents.base import AgentSettings
from pecjax.agents.networks import NetworkSettings
from pecjax.envs.rooms.settings import Rooms
from pecjax.studies.grid import StudySettings, Values
from pecjax.training.presets import PRESETS
from pecjax.training.settings import EvaluationSettings, StopSettings

BENCHMARK = "samplers"  # all of its studies; of one the name is samplers-CELL
SCALES = ("smoke", "laptop", "full", "screening")
FLIGHTS = 2  # of each held-out configuration, in an evaluation; in the screening one


class Cell(NamedTuple):
    """A space with a learner and a budget.

    Attributes:
        space: where it is learned.
        held_out: how many configurations are.
        iterations: of each run.
        every: iterations between evaluations.
        thresholds: goal ratios; what is compared first are the steps to the middle one.
        measured: the column of the results that is compared.
        agent: the learner.
        seeds: of the confirmation.
    """

    space: str
    held_out: int
    iterations: int
    every: int
    thresholds: tuple[float, float, float]
    measured: str = "goal_ratio"
    agent: AgentSettings = PPO()
    seeds: int = 10


_REMEMBERS = PPO(num_steps=64, num_minibatches=16, network=NetworkSettings(memory="mingru", memory_size=128))
CELLS: dict[str, Cell] = {
    "paper-2": Cell("paper-2", 362, 192, 12, (0.8, 0.9, 0.95)),
    "rooms-pairs": Cell("rooms-pairs", 1000, 160, 10, (0.7, 0.8, 0.9)),
    "rooms-longtail": Cell("rooms-longtail", 1000, 256, 16, (0.3, 0.5, 0.7), "goal_ratio.hard"),
    "rooms-storm": Cell("rooms-storm", 1000, 192, 12, (0.25, 0.3, 0.35)),
    "floorplans": Cell("floorplans", 1000, 300, 20, (0.5, 0.6, 0.7), agent=_REMEMBERS),
    "tasks": Cell("tasks", 900, 512, 32, (0.7, 0.8, 0.9)),
    "rooms-pairs-apex": Cell("rooms-pairs", 1000, 350, 25, (0.6, 0.7, 0.8), agent=Apex(), seeds=5),
}
SCREENED = ("rooms-pairs", "rooms-longtail", "rooms-storm")  # on seeds that the confirmation does not have
SCREENING_SEEDS = (100, 101, 102)


def _conditions(sampler: str, **numbers: tuple[float, ...]) -> list[Values]:
    """A sampler with its defaults, then with other values of its numbers, each changed alone."""
    kind = ("sampler", sampler)
    changed = [(name, value) for name, values in numbers.items() for value in values]
    return [(kind,), *((kind, (f"sampler.{name}", value)) for name, value in changed)]


SCREENING: tuple[Values, ...] = (
    *_conditions("uniform"),
    *_conditions("pec", alpha=(0.05, 1.0)),
    *_conditions("forgetting", alpha=(1.0,), half_life=(5.0,)),
    *_conditions("failure_ema", power=(1.0,), half_life=(3.0,)),
    *_conditions("learnability", half_life=(10.0,)),
    *_conditions("thompson", half_life=(3.0,)),
    *_conditions("pass_at_n", tries=(2.0,), half_life=(3.0,)),
    *_conditions("table_top", tries=(2.0,), half_life=(3.0,)),
    *_conditions("learning_progress", fast=(2.0,)),
    *_conditions("dro", step=(0.2,), half_life=(3.0,)),
    *_conditions("plr", temperature=(1.0,)),
    *_conditions("sfl", scoring=(1.0,)),
    *_conditions("floor", epsilon=(0.3,)),
    *_conditions("mixture", share=(0.25,)),
    *_conditions("per_step"),
)
CONFIRMATION: tuple[Values, ...] = (  # as the rule of docs/benchmark.md chose
    *_conditions("uniform"),
    *_conditions("pec"),
    *_conditions("forgetting"),
    (("sampler", "dro"), ("sampler.half_life", 3.0)),
    (("sampler", "floor"), ("sampler.epsilon", 0.3)),
)


def _study(name: str, cell: Cell, scale: str) -> StudySettings:
    run = dataclasses.replace(
        PRESETS["apex-fast" if isinstance(cell.agent, Apex) else "fast"],
        task=Rooms(space=cell.space),
        agent=cell.agent,
        stop=StopSettings(iterations=cell.iterations),
        evaluation=EvaluationSettings(
            every=cell.every, episodes=cell.held_out * (1 if scale == "screening" else FLIGHTS)
        ),
    )
    if scale == "smoke":
        run = dataclasses.replace(
            run,
            stop=StopSettings(iterations=4),
            evaluation=EvaluationSettings(every=2, episodes=40),
        )
    seeds = {"smoke": range(2), "laptop": range(3), "full": range(cell.seeds), "screening": SCREENING_SEEDS}
    conditions = SCREENING if scale == "screening" else CONFIRMATION
    return StudySettings(name, run, (), tuple(seeds[scale]), conditions=conditions)


STUDIES: dict[str, dict[str, StudySettings]] = {
    f"{BENCHMARK}-{name}": {
        scale: _study(f"{BENCHMARK}-{name}", cell, scale)
        for scale in SCALES
        if scale != "screening" or name in SCREENED
    }
    for name, cell in CELLS.items()
}


def members(name: str, scale: str) -> list[str]:
    """The benchmark's studies of that name: one, all that have the scale, or none of another study's name.

    Of a scale that none has it is all of them, whose error then says so.
    """
    if name == BENCHMARK:
        return [study for study, scales in STUDIES.items() if scale in scales] or [*STUDIES]
    return [name] if name in STUDIES else []


def cell(name: str) -> str:
    """The cell that a study of the benchmark is of."""
    return name.removeprefix(f"{BENCHMARK}-")
