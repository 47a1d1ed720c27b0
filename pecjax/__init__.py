"""pecjax: drones that find their way through rooms, trained on the accelerator with PEC."""

import contextlib
import importlib
import io

# mjx prints a line to stdout where its optional Warp back-end is absent; stdout is for results.
with contextlib.redirect_stdout(io.StringIO()):
    importlib.import_module("mujoco.mjx")

from pecjax import agents as agents, curriculum as curriculum
from pecjax.errors import InputError as InputError
from pecjax.world import (
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
