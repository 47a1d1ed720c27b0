"""Bounds of what a memory can give: the same drone shown what it would have to find out.

    pecjax train --task bounds:Guided --task.space floorplans      # in this folder
    pecjax train --task bounds:FromAbove --task.space floorplans

`Guided` shows where the shortest path leads, and how long it is. `FromAbove` shows the walls around the
drone from above, turned with it. Neither is to be had in flight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import distance_transform_edt

import pecjax
from pecjax.envs.rooms import RoomsTask
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.clearance_grid import make_grid
from pecjax.envs.rooms.geodesics import find_paths, free_clearance, search
from pecjax.envs.rooms.maps import FAR_AWAY, MapBank, pick
from pecjax.envs.rooms.rotations import heading
from pecjax.envs.rooms.sensing import DISTANCE_SCALE
from pecjax.envs.spaces import Box
from pecjax.envs.task import World
from pecjax.errors import InputError

CELL = 0.2  # m, of the grid of paths
AHEAD = 5  # cells of a path: where it leads to, seen from where the drone is
SIDE, REACH, FAR = 16, 8.0, 2.0  # pixels; m to each side; m from a wall beyond which it is not shown


class Ways(NamedTuple):
    """Shortest paths to the one goal of each map.

    Attributes:
        bank: the maps.
        bearing: (M, X, Y) int8, the direction in which a path goes on, in 1/256 of a turn.
        length: (M, X, Y) uint8, of the path, in steps of 0.25 m.
        origin: (M, 2) m, of the grids.
    """

    bank: MapBank
    bearing: jax.Array
    length: jax.Array
    origin: jax.Array


class ShowingTask(RoomsTask):
    """The rooms, with something more to see."""

    shown: ClassVar[dict[str, Box]]

    def __init__(self, *args: Any, **more: Any) -> None:
        """See `RoomsTask`."""
        super().__init__(*args, **more)
        self.observation_space = self.observation_space | self.shown


class GuidedTask(ShowingTask):
    """The rooms, with the length of the path and its direction (sine and cosine off the heading)."""

    shown: ClassVar = {"way": Box((3,))}

    def observe(self, key: Any, state: Any, params: Any) -> Any:
        """What the drone sees, and the way."""
        number = state.config.map_id
        cell = jnp.round((state.qpos[:2] - params.origin[number]) / CELL).astype(jnp.int32)
        place = (number, *jnp.clip(cell, 0, np.array(params.bearing.shape[1:]) - 1))
        turn = params.bearing[place] * (2 * jnp.pi / 256) - heading(state.qpos[3:])
        length = params.length[place] * (0.25 / DISTANCE_SCALE)
        way = jnp.stack([length, jnp.sin(turn), jnp.cos(turn)])
        return super().observe(key, state, params) | {"way": way}


class FromAboveTask(ShowingTask):
    """The rooms, with an image of how far from a wall each place around the drone is."""

    shown: ClassVar = {"above": Box((SIDE, SIDE), 0.0, 1.0)}

    def observe(self, key: Any, state: Any, params: Any) -> Any:
        """What the drone sees, and the walls: ahead of it is up."""
        walls, turn = pick(params.bank, state.config.map_id), heading(state.qpos[3:])
        along = jnp.linspace(REACH, -REACH, SIDE)
        ahead, left = (part.ravel() for part in jnp.meshgrid(along, along, indexing="ij"))
        x = state.qpos[0] + ahead * jnp.cos(turn) - left * jnp.sin(turn)
        y = state.qpos[1] + ahead * jnp.sin(turn) + left * jnp.cos(turn)
        points = jnp.stack([x, y, jnp.full_like(x, self.settings.flight_height)], axis=-1)
        above = jnp.minimum(wall_distance(walls, points) / FAR, 1.0).reshape(SIDE, SIDE)
        return super().observe(key, state, params) | {"above": above}


@dataclass(frozen=True)
class FromAbove(pecjax.Rooms):
    """The rooms with a view of the map."""

    task_kind: ClassVar = FromAboveTask


@dataclass(frozen=True)
class Guided(pecjax.Rooms):
    """The rooms with the way, in spaces of one goal a map."""

    task_kind: ClassVar = GuidedTask

    def make(self) -> tuple[Any, World]:
        """The task and its world, with the paths of all maps: of 10,000 in about a minute."""
        task, world = super().make()
        return task, world._replace(params=self._ways(world.params.bank, task.vehicle.radius))

    def _ways(self, bank: MapBank, radius: float) -> Ways:
        space = self.read_space()
        if space is None:
            raise InputError("name a space: --task.space floorplans")
        goals = np.full((len(bank.bounds), 2), np.nan)
        for part in (space.train, space.held_out):
            goals[part.table.map_id] = part.table.goal
            if not np.array_equal(goals[part.table.map_id], part.table.goal):
                raise InputError(f"space '{self.space}' has several goals in a map; floorplans has one")
        lower, upper, bounds = map(np.asarray, (bank.lower, bank.upper, bank.bounds))
        shape = np.round((bounds[:, 1] - bounds[:, 0]).max(axis=0) / CELL).astype(int) + 1
        bearing = np.zeros((len(goals), *shape), np.int8)
        length = np.full((len(goals), *shape), 255, np.uint8)
        for number, goal in enumerate(goals):
            there = lower[number, :, 0] < FAR_AWAY
            corners = (corner[number, there] for corner in (lower, upper))
            found = _way_to(goal, *corners, bounds[number], self.flight_height, radius)
            x, y = found[0].shape
            bearing[number, :x, :y], length[number, :x, :y] = found
        return Ways(bank, *map(jnp.asarray, (bearing, length, bounds[:, 0].astype(np.float32))))


def _way_to(
    goal: np.ndarray, lower: np.ndarray, upper: np.ndarray, bounds: np.ndarray, height: float, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Bearings and lengths (X, Y) of one map, as `Ways` has them; of a place on no path those of the next."""
    reach = free_clearance(radius, CELL) + CELL
    grid = make_grid(lower, upper, bounds, flight_height=height, cell=CELL, reach=reach)
    paths = find_paths(grid, radius)
    (distance,), (towards,) = search(paths, goal[None])
    onwards = np.where(towards < 0, np.arange(len(towards)), towards)
    place = np.arange(len(onwards))
    for _ in range(AHEAD):
        place = onwards[place]
    last = np.where((towards[place] < 0)[:, None], goal, paths.places[place])
    offset = last - paths.places
    turn = np.round(np.arctan2(offset[:, 1], offset[:, 0]) * (256 / (2 * np.pi))).astype(int)
    known = (paths.number >= 0) & np.isfinite(distance)[paths.number]
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    node = paths.number[tuple(nearest)]
    bearing, length = (turn[node] + 128) % 256 - 128, np.minimum(4 * distance[node], 255)
    return bearing.astype(np.int8), length.astype(np.uint8)
