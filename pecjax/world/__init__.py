"""The world: scene, coordinates, flight, depth and the navigation task."""

from pecjax.world.coordinates import (
    COORDINATE_SET_1 as COORDINATE_SET_1,
    COORDINATE_SET_2 as COORDINATE_SET_2,
    Configurations as Configurations,
    load_coordinates as load_coordinates,
)
from pecjax.world.depth import depth_image as depth_image
from pecjax.world.flight import ControllerGains as ControllerGains
from pecjax.world.navigation import (
    NavigationSettings as NavigationSettings,
    RoomsNavigation as RoomsNavigation,
)
from pecjax.world.scene import Scene as Scene, load_scene as load_scene
from pecjax.world.validity import check_coordinates as check_coordinates
