"""Names of samplers: how a user names one, and how it is shown."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pecjax import settings_tree
from pecjax.curriculum import SamplerSettings
from pecjax.errors import InputError
from pecjax.storage.files import exact_text

_SHORT = "pecjax.curriculum"  # where samplers have short names (see `settings_tree.resolve`)
_GREEK = {"alpha": "α", "beta": "β", "gamma": "γ"}


def make_sampler(name: str, like: SamplerSettings | None = None) -> SamplerSettings:
    """The sampler of that name with its own default numbers, or those of `like` if it is one.

    Raises:
        InputError: there is none, or one of its numbers has no default.
    """
    kind: type[Any] = settings_tree.resolve(name, SamplerSettings, _SHORT)
    if like is not None and type(like) is kind:
        return like
    try:
        return kind()
    except TypeError as error:
        raise InputError(f"sampler {name}: {error}; give every setting a default") from error


def sampler_name(sampler: SamplerSettings) -> str:
    """The name that `make_sampler` knows it by."""
    return settings_tree.short_name(type(sampler), _SHORT)


def label(name: str, values: Iterable[tuple[str, Any]]) -> list[str]:
    """What people are shown: the sampler's class or short name, and each value by the last of its path."""
    return [
        name.rpartition(":")[2],
        *(
            f"{_GREEK.get(last, last)} = {exact_text(value) if isinstance(value, float) else value}"
            for last, value in ((path.rpartition(".")[2], value) for path, value in values)
        ),
    ]


def sampler_label(sampler: SamplerSettings) -> str:
    """Its name with its numbers, for people."""
    name, *numbers = label(sampler_name(sampler), settings_tree.leaves(sampler))
    return f"{name} ({', '.join(numbers)})" if numbers else name


def has_alpha(sampler: SamplerSettings) -> bool:
    """Whether α means anything to the sampler."""
    return "alpha" in dict(settings_tree.leaves(sampler))
