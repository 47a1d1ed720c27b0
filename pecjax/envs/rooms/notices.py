"""Notices: what is allowed in a map and its coordinates, but seldom meant."""

from __future__ import annotations

import numpy as np

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.navigation import NavigationSettings
from pecjax.envs.rooms.scene import Scene
from pecjax.envs.rooms.validity import free_regions, regions_at

FEW_PHYSICS_STEPS = 10  # per action; with more, physics is most of what a training does
_MUJOCO_TIMESTEP = 0.002  # s, where a map says nothing


def world_notices(
    scene: Scene, table: Configurations, settings: NavigationSettings = NavigationSettings()
) -> tuple[str, ...]:
    """One line for each thing that a person should know of a world that can be flown.

    They are notices and no errors: a fine timestep, an open map or an easy goal may be wanted.
    """
    lines = []
    timestep = scene.model.opt.timestep
    steps = round(settings.control_period / timestep)
    if steps > FEW_PHYSICS_STEPS:
        default = " (MuJoCo's default, if the map has no <option timestep=…>)"
        lines.append(
            f"the map's timestep is {timestep:g} s{default if timestep == _MUJOCO_TIMESTEP else ''}: {steps} "
            "physics steps per action make training several times slower; 0.02 s is usual"
        )
    regions, origin = free_regions(scene, settings.flight_height)
    border = np.concatenate([regions[0], regions[-1], regions[:, 0], regions[:, -1]])
    if np.isin(border[border > 0], regions_at(regions, origin, np.asarray(table.start))).any():
        lines.append(
            "the map has no closed outer walls: the drone can fly out of it, until its episode's steps are "
            "used up; add walls around it"
        )
    distance = np.linalg.norm(np.asarray(table.goal) - np.asarray(table.start), axis=1)
    near = np.flatnonzero(distance < settings.goal_radius)
    if near.size:
        first = near[0]
        lines.append(
            f"configuration {first}: the goal is {distance[first]:.2f} m from the start, within the goal "
            f"radius of {settings.goal_radius:g} m, and is reached at once"
            + (f"; so it is in {near.size - 1} more" if near.size > 1 else "")
        )
    return tuple(lines)
