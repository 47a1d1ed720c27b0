"""Former versions: converts their files to today's form."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from pecjax import settings_tree
from pecjax.agents import PPO, Apex
from pecjax.curriculum import PEC
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.task import TaskSettings
from pecjax.errors import InputError
from pecjax.training.kinds import has_alpha, make_kind

FILES = ("scene.xml", "coordinates.csv")  # of a run's task, which version 0.1 did not list
_AGENTS = {"ppo": PPO, "apex": Apex}
_AGENT_PATH = re.compile(r"^(ppo|apex)\.")
_RENAMED = {"clip": "clip_epsilon", "fragment": "rollout_length", "huber": "huber_delta"}


def run_settings(content: Any) -> Any:
    """A run's settings: version 0.1 had those of map, evaluation and end at the top, and both learners'.

    Before maps could mark starts and goals, a table was never None, and set 1 where there was a space.
    What is no dictionary is left to who reads settings.
    """
    if not isinstance(content, Mapping):
        return content
    if "algorithm" not in content:
        if _has_unused_table(content):
            content = {**content, "task": {**content["task"], "table": None}}
        return {**content, "agent": _agent(content["agent"])} if "agent" in content else content
    agent = str(content["algorithm"])
    if agent not in _AGENTS:
        raise InputError(f"unknown algorithm '{agent}'; choose one of {', '.join(_AGENTS)}")
    numbers: dict[str, Any] = dict(content.get(agent, {}))
    task: dict[str, Any] = {"table": content.get("coordinates", "1"), "resolution": content.get("resolution")}
    if content.get("scene") is not None:
        task["maps"] = [content["scene"]]
    return {
        "task": _kind(Rooms, task),
        "sampler": _sampler(content),
        "agent": _agent(_kind(_AGENTS[agent], {_RENAMED.get(n, n): value for n, value in numbers.items()})),
        "evaluation": {
            name: content[former]
            for name, former in {
                "every": "evaluate_every",
                "episodes": "evaluation_episodes",
                "seed": "evaluation_seed",
                "greedy": "greedy",
            }.items()
            if former in content
        },
        "stop": _taken(content, "iterations", "until_goal_ratio", "patience"),
        **_taken(content, "preset", "seed", "configurations_every"),
    }


def _agent(agent: Any) -> Any:
    """An agent's settings; what is of neither PPO nor Ape-X, or no dictionary, as it is."""
    if not isinstance(agent, Mapping):
        return agent
    kind, network = agent.get(settings_tree.KIND), agent.get("network", {})
    if kind == settings_tree.address(PPO) and isinstance(network, Mapping):
        # Once its critic always read what the actor reads, in products of float32.
        return {**agent, "network": {"critic": "observation", "precision": "float32", **network}}
    if kind == settings_tree.address(Apex) and "decay_updates" in agent:
        return _with_decay_steps(dict(agent))
    return agent


def _with_decay_steps(agent: dict[str, Any]) -> dict[str, Any]:
    """Ape-X's rate once fell over a number of updates, not of environment steps."""
    updates, default = agent.pop("decay_updates"), Apex()
    if updates is None:
        return {**agent, "decay_steps": None}
    batch_size, ratio = (agent.get(name, getattr(default, name)) for name in ("batch_size", "replay_ratio"))
    steps = updates  # as wrong as it was, where one of them is no number
    if all(isinstance(number, int | float) for number in (updates, batch_size, ratio)):
        with contextlib.suppress(OverflowError, ValueError, ZeroDivisionError):
            steps = round(updates * batch_size / ratio)
    return {**agent, "decay_steps": steps}


def _has_unused_table(run: Any) -> bool:
    task = run.get("task") if isinstance(run, Mapping) else None
    return isinstance(task, Mapping) and task.get("space") is not None and task.get("table") == "1"


def _taken(content: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: content[name] for name in names if name in content}


def _kind(kind: type, content: Mapping[str, Any]) -> dict[str, Any]:
    return {settings_tree.KIND: settings_tree.address(kind), **content}


def _sampler(content: Mapping[str, Any]) -> Any:
    """Its settings; once there were only its name and, whether it had one or not, an α."""
    sampler = content.get("sampler", "pec")
    if isinstance(sampler, Mapping):
        return sampler
    try:
        made = make_kind("sampler", str(sampler))
    except InputError:
        return sampler  # as wrong as it was
    numbers = settings_tree.to_json(made)
    if has_alpha(made):
        numbers["alpha"] = content.get("alpha", numbers["alpha"])
    return _kind(type(made), numbers)


def study_task(task: TaskSettings, folder: Path) -> TaskSettings:
    """A task of a study of version 0.1, which kept its files under other names."""
    table = folder / f"coordinates-{Path(getattr(task, 'table', '')).stem}.csv"
    return dataclasses.replace(cast(Rooms, task), table=str(table), maps=(str(folder / FILES[0]),))


def study_settings(content: Any) -> Any:
    """A study's settings; once samplers, α and coordinates were no part of its grid, then set 1 always."""
    if not isinstance(content, Mapping):
        return content
    if "samplers" not in content:
        if _has_unused_table(content.get("run")):
            grid = [pair for pair in content["grid"] if pair != ["task.table", ["1"]]]
            content = {**content, "grid": grid}
        return {**content, "run": run_settings(content["run"])} if "run" in content else content
    grid = [
        ["task.table", content.get("coordinates", ["1"])],
        ["sampler", content["samplers"]],
        ["sampler.alpha", content.get("alphas", [PEC().alpha])],
        *([_AGENT_PATH.sub("agent.", path), values] for path, values in content.get("grid", [])),
    ]
    now = {"name": "name", "seeds": "seeds", "at_once": "parallel_runs"}
    rest = {now[name]: value for name, value in content.items() if name in now}
    return rest | {"grid": grid, "run": run_settings(content.get("run"))}
