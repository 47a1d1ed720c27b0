"""Studies by name and scale: the paper's experiments as grids, beside the benchmark's."""

from __future__ import annotations

import dataclasses

from pecjax.agents import PPO, Apex
from pecjax.agents.apex.q_network import QNetworkSettings
from pecjax.agents.apex.replay import ReplaySettings
from pecjax.agents.networks import NetworkSettings
from pecjax.errors import InputError, nearest
from pecjax.studies import benchmark
from pecjax.studies.grid import StudySettings
from pecjax.training.presets import PRESETS
from pecjax.training.settings import EvaluationSettings, RunSettings, StopSettings, override

OWN = "own"  # the name of a study that is not in this catalogue

_ALPHAS = (0.0, 0.1, 0.2, 0.3, 0.4)
_PEC_AND_UNIFORM = ("pec", "uniform")
_FAST = override(PRESETS["fast"], evaluate_every=15)
_APEX = override(PRESETS["apex-fast"], evaluate_every=10)
_SMOKE = dataclasses.replace(
    PRESETS["fast"],
    agent=PPO(num_envs=8, num_steps=32, num_minibatches=2, network=NetworkSettings(hidden=(8,))),
    stop=StopSettings(iterations=4),
    evaluation=EvaluationSettings(every=2, episodes=40),
)
_APEX_SMOKE = dataclasses.replace(
    _SMOKE,
    preset="apex-fast",
    agent=Apex(
        num_envs=8,
        num_steps=32,
        learning_starts=64,
        batch_size=32,
        network=QNetworkSettings(trunk=(8,), head=8),
        replay=ReplaySettings(capacity=1024),
    ),
)


def _study(
    name: str,
    run: RunSettings,
    iterations: int | None,
    seeds: int,
    coordinates: str = "1",
    samplers: tuple[str, ...] = _PEC_AND_UNIFORM,
    alphas: tuple[float, ...] = (0.2,),
) -> StudySettings:
    grid = (("task.table", (coordinates,)), ("sampler", samplers), ("sampler.alpha", alphas))
    return StudySettings(name, override(run, iterations=iterations), grid, tuple(range(seeds)))


# Jang & Choi (2022): Fig. 4-7, §5.2; Fig. 8-10, §5.3; Fig. 11-12, §5.4; Fig. 13-14, §5.5.
STUDIES: dict[str, dict[str, StudySettings]] = {
    "fig4": {
        "smoke": _study("fig4", _SMOKE, None, 2),
        "laptop": _study("fig4", _FAST, 300, 10),
        "paper": _study("fig4", PRESETS["rllib085"], 1500, 3),
    },
    "fig8": {
        "smoke": _study("fig8", _SMOKE, None, 2, "2"),
        "laptop": _study("fig8", _FAST, 450, 10, "2"),
        "paper": _study("fig8", PRESETS["rllib085"], 5000, 3, "2"),
    },
    "fig11": {
        "smoke": _study("fig11", _SMOKE, None, 2, samplers=("pec",), alphas=_ALPHAS),
        "laptop": _study("fig11", _FAST, 300, 5, samplers=("pec",), alphas=_ALPHAS),
        "paper": _study("fig11", PRESETS["rllib085"], 1500, 3, samplers=("pec",), alphas=_ALPHAS),
    },
    "fig14": {
        "smoke": _study("fig14", _APEX_SMOKE, None, 2),
        "laptop": _study("fig14", _APEX, 350, 5),
        "paper": _study("fig14", PRESETS["apex-rllib085"], 2000, 3),
    },
}


def find_study(name: str, scale: str = "laptop") -> StudySettings:
    """The study of that name.

    Args:
        scale: `smoke` (seconds, to try it), `laptop` (two cores, our own presets) or `paper` (its
            iteration counts and RLlib's settings); of the benchmark of samplers `smoke`, `laptop` (three
            seeds), `full` (all that are confirmed), or `screening`.

    Raises:
        InputError: there is no such study or scale.
    """
    known = STUDIES | benchmark.STUDIES
    if name not in known:
        names = ", ".join([*STUDIES, benchmark.BENCHMARK])
        raise InputError(
            f"unknown study '{name}'{nearest(name, [*known])}; choose one of {names}, or name none"
        )
    if scale not in known[name]:
        raise InputError(f"unknown scale '{scale}' of {name}; choose one of {', '.join(known[name])}")
    return known[name][scale]
