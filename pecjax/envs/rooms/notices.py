"""Notices: what is allowed in a map and its coordinates, but seldom meant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pecjax.envs.rooms.config import REACH, Configurations
from pecjax.envs.rooms.map_file import Map
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.validity import free_regions, regions_at
from pecjax.envs.rooms.vehicle import Vehicle

FEW_PHYSICS_STEPS = 10  # per action; with more, physics is most of what a training does
_MUJOCO_TIMESTEP = 0.002  # s, where a map says nothing


def map_notices(
    maps: Sequence[Map], table: Configurations, vehicle: Vehicle, settings: NavigationSettings
) -> tuple[str, ...]:
    """One line for each thing that a person should know of maps that can be flown.

    They are notices and no errors: a fine timestep, an open map or an easy goal may be wanted.
    """
    lines = []
    timestep = vehicle.timestep
    steps = round(settings.control_period / timestep)
    if steps > FEW_PHYSICS_STEPS:
        default = " (MuJoCo's default, if the map has no <option timestep=…>)"
        lines.append(
            f"the map's timestep is {timestep:g} s{default if timestep == _MUJOCO_TIMESTEP else ''}: {steps} "
            "physics steps per action make training several times slower; 0.02 s is usual"
        )
    open_maps = [
        n for n in np.unique(np.asarray(table.map_id)) if _is_open(maps[n], n, table, vehicle, settings)
    ]
    if open_maps:
        which = "the map" if len(maps) == 1 else f"map {open_maps[0]}"
        lines.append(
            f"{which} has no closed outer walls: the drone can fly out of it, until its episode's steps are "
            "used up; add walls around it"
        )
    distance = np.linalg.norm(np.asarray(table.goal) - np.asarray(table.start), axis=1)
    reaches = True if table.objective is None else np.asarray(table.objective) == REACH
    near = np.flatnonzero((distance < settings.goal_radius) & reaches)
    if near.size:
        first = near[0]
        lines.append(
            f"configuration {first}: the goal is {distance[first]:.2f} m from the start, within the goal "
            f"radius of {settings.goal_radius:g} m, and is reached at once"
            + (f"; so it is in {near.size - 1} more" if near.size > 1 else "")
        )
    return tuple(lines)


def _is_open(
    one: Map, number: int, table: Configurations, vehicle: Vehicle, settings: NavigationSettings
) -> bool:
    """Whether a path leads from a start of the map to its border."""
    regions, origin = free_regions(one, vehicle.radius, settings.flight_height)
    border = np.concatenate([regions[0], regions[-1], regions[:, 0], regions[:, -1]])
    starts = np.asarray(table.start)[np.asarray(table.map_id) == number]
    return bool(np.isin(border[border > 0], regions_at(regions, origin, starts)).any())
