"""Kinds: names of tasks, samplers and agents, as users type and see them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pecjax import settings_tree
from pecjax.agents import AgentSettings
from pecjax.curriculum import SamplerSettings
from pecjax.envs.task import TaskSettings
from pecjax.errors import InputError
from pecjax.storage.files import exact_text

# What a run has a kind of, and the package whose kinds have short names (see `settings_tree.resolve`).
KINDS: dict[str, tuple[type, str]] = {
    "task": (TaskSettings, "pecjax.envs"),
    "sampler": (SamplerSettings, "pecjax.curriculum"),
    "agent": (AgentSettings, "pecjax.agents"),
}
_GREEK = {"alpha": "α", "beta": "β", "gamma": "γ"}


def make_kind(slot: str, name: str, like: Any = None) -> Any:
    """The kind of that name with its own default numbers, or `like` if it is one.

    Args:
        slot: task, sampler or agent.

    Raises:
        InputError: there is none, or one of its numbers has no default.
    """
    kind: type[Any] = settings_tree.resolve(name, *KINDS[slot])
    if type(like) is kind:
        return like
    try:
        return kind()
    except TypeError as error:
        raise InputError(f"{slot} {name}: {error}; give every setting a default") from error


def kind_name(value: Any) -> str:
    """The name that `make_kind` knows it by."""
    package = next(package for base, package in KINDS.values() if isinstance(value, base))
    return settings_tree.short_name(type(value), package)


def label(name: str, values: Iterable[tuple[str, Any]]) -> list[str]:
    """What people are shown: the class or short name, and each value by the last of its path."""
    return [
        name.rpartition(":")[2],
        *(
            f"{_GREEK.get(last, last)} = {exact_text(value) if isinstance(value, float) else value}"
            for last, value in ((path.rpartition(".")[2], value) for path, value in values)
        ),
    ]


def sampler_label(sampler: SamplerSettings) -> str:
    """Its name with its numbers, for people."""
    name, *numbers = label(kind_name(sampler), settings_tree.leaves(sampler))
    return f"{name} ({', '.join(numbers)})" if numbers else name


def run_label(settings: Any) -> str:
    """What a RunSettings is of, for people: sampler, agent, task and seed."""
    task, agent = kind_name(settings.task), kind_name(settings.agent)
    table, space = (getattr(settings.task, name, None) for name in ("table_name", "space"))
    if isinstance(space, str):
        task = space.rpartition("/")[2]
    else:
        task = f"coordinates {table.rpartition('/')[2]}" if isinstance(table, str) else label(task, ())[0]
    shown = AGENT_LABELS.get(agent, label(agent, ())[0])
    return f"{sampler_label(settings.sampler)}, {shown}, {task}, seed {settings.seed}"


AGENT_LABELS = {"ppo": "PPO", "apex": "Ape-X DQN"}


def has_alpha(sampler: SamplerSettings) -> bool:
    """Whether α means anything to the sampler."""
    return "alpha" in dict(settings_tree.leaves(sampler))
