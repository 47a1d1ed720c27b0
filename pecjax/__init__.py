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
        RoomsNavigation as RoomsNavigation,
        Scene as Scene,
        check_coordinates as check_coordinates,
        depth_image as depth_image,
        load_coordinates as load_coordinates,
        load_scene as load_scene,
    )

__version__ = "0.1.0"

# Loaded when they are first asked for: who wants the samplers alone needs no simulator.
_SUBPACKAGES = ("agents", "curriculum", "envs")
_FROM_ROOMS = (
    "COORDINATE_SET_1",
    "COORDINATE_SET_2",
    "Configurations",
    "ControllerGains",
    "NavigationSettings",
    "RoomsNavigation",
    "Scene",
    "check_coordinates",
    "depth_image",
    "load_coordinates",
    "load_scene",
)


def __getattr__(name: str) -> Any:
    """Loads a public name (PEP 562)."""
    if name in _SUBPACKAGES:
        return importlib.import_module(f"pecjax.{name}")
    if name in _FROM_ROOMS:
        return getattr(importlib.import_module("pecjax.envs.rooms"), name)
    raise AttributeError(f"module 'pecjax' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *_SUBPACKAGES, *_FROM_ROOMS})
