"""Former versions: what their files hold, as it is written today."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pecjax import settings_tree
from pecjax.errors import InputError
from pecjax.training.samplers import has_alpha, make_sampler


def array_name(name: str) -> str:
    """Where the position of a former run holds what is now under `name`.

    The first version 0.1 had the configuration and the counters of an episode in Brax's `info`, and
    uniform sampling kept no counts; a position has those of the whole training.
    """
    if name == ".state.sampler.numbers['alpha']":
        return ".state.sampler.alpha"
    if name == ".state.sampler.counts":
        return ".counts"
    return re.sub(r"\.pipeline_state\.(config|step_count|standing_count)", r".info['\1']", name)


def about(content: Any) -> Any:
    """What the arrays of a position belong to."""
    if not isinstance(content, Mapping):
        return content
    return {**content, "settings": run_settings(content.get("settings"))}


def run_settings(content: Any) -> Any:
    """A run's settings: once they had the sampler's name and, whether it had one or not, an α."""
    if not isinstance(content, Mapping) or isinstance(content.get("sampler"), Mapping):
        return content
    rest = {name: value for name, value in content.items() if name != "alpha"}
    try:
        sampler = make_sampler(str(content.get("sampler", "pec")))
    except InputError:
        return content  # as wrong as it was
    numbers = settings_tree.to_json(sampler)
    if has_alpha(sampler):
        numbers["alpha"] = content.get("alpha", numbers["alpha"])
    kind = {settings_tree.KIND: settings_tree.address(type(sampler))}
    return rest | {"sampler": kind | numbers}


def study_settings(content: Any) -> Any:
    """A study's settings, with those that its runs share."""
    if not isinstance(content, Mapping):
        return content
    return {"grid": [], **content, "run": run_settings(content.get("run"))}
