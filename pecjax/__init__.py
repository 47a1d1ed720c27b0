"""pecjax: drones that find their way through rooms, trained on the accelerator with PEC."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from pecjax.errors import InputError as InputError

if TYPE_CHECKING:
    from pecjax import agents as agents, curriculum as curriculum, envs as envs
    from pecjax.envs.rooms import (
        COORDINATE_SET_1 as COORDINATE_SET_1,
        COORDINATE_SET_2 as COORDINATE_SET_2,
        Configurations as Configurations,
        ControllerGains as ControllerGains,
        NavigationSettings as NavigationSettings,
        Rooms as Rooms,
        Scene as Scene,
        check_coordinates as check_coordinates,
        depth_image as depth_image,
        load_coordinates as load_coordinates,
        load_scene as load_scene,
    )
    from pecjax.envs.rooms.brax_env import RoomsNavigation as RoomsNavigation
    from pecjax.envs.task import Task as Task, TaskSettings as TaskSettings
    from pecjax.export.files import export_policy as export_policy
    from pecjax.runtime.devices import use_all_cores as use_all_cores
    from pecjax.settings_tree import set_path as set_path
    from pecjax.training import sinks as sinks
    from pecjax.training.load import open_run as open_run
    from pecjax.training.presets import find_preset as find_preset
    from pecjax.training.result import train as train
    from pecjax.training.settings import RunSettings as RunSettings
    from pecjax.training.sinks import Sink as Sink

__version__ = "0.2.0.dev0"

# Loaded when they are first asked for: who wants the samplers alone needs no simulator.
_SUBPACKAGES = {
    "agents": "pecjax.agents",
    "curriculum": "pecjax.curriculum",
    "envs": "pecjax.envs",
    "sinks": "pecjax.training.sinks",
}
_NAMES = {
    **dict.fromkeys(
        (
            "COORDINATE_SET_1",
            "COORDINATE_SET_2",
            "Configurations",
            "ControllerGains",
            "NavigationSettings",
            "Rooms",
            "Scene",
            "check_coordinates",
            "depth_image",
            "load_coordinates",
            "load_scene",
        ),
        "pecjax.envs.rooms",
    ),
    "RoomsNavigation": "pecjax.envs.rooms.brax_env",  # Brax takes a second to import
    "Task": "pecjax.envs.task",
    "TaskSettings": "pecjax.envs.task",
    "export_policy": "pecjax.export.files",
    "set_path": "pecjax.settings_tree",
    "RunSettings": "pecjax.training.settings",
    "Sink": "pecjax.training.sinks",
    "find_preset": "pecjax.training.presets",
    "open_run": "pecjax.training.load",
    "train": "pecjax.training.result",
    "use_all_cores": "pecjax.runtime.devices",
}


def __getattr__(name: str) -> Any:
    """Loads a public name (PEP 562)."""
    if name in _SUBPACKAGES:
        return importlib.import_module(_SUBPACKAGES[name])
    if name in _NAMES:
        return getattr(importlib.import_module(_NAMES[name]), name)
    raise AttributeError(f"module 'pecjax' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *_SUBPACKAGES, *_NAMES})
