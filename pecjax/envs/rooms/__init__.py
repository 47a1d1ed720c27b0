"""The rooms: maps, drone, flight, depth camera and the task of flying to a goal."""

from pecjax.envs.rooms.config import (
    COORDINATE_SET_1 as COORDINATE_SET_1,
    COORDINATE_SET_2 as COORDINATE_SET_2,
    Configurations as Configurations,
    load_coordinates as load_coordinates,
)
from pecjax.envs.rooms.controller import ControllerGains as ControllerGains
from pecjax.envs.rooms.depth import depth_image as depth_image
from pecjax.envs.rooms.rules import NavigationSettings as NavigationSettings
from pecjax.envs.rooms.scene import Scene as Scene, load_scene as load_scene
from pecjax.envs.rooms.settings import Rooms as Rooms
from pecjax.envs.rooms.task import RoomsTask as RoomsTask
from pecjax.envs.rooms.validity import check_coordinates as check_coordinates
