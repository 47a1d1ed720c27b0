"""Bounds of what a memory can give: the same drone shown what it would have to find out.

    pecjax train --task bounds:Guided --task.space floorplans      # in this folder
    pecjax train --task bounds:FromAbove --task.space floorplans

`Guided` shows where the shortest path leads, and how long it is. `FromAbove` shows the walls around the
drone from above, turned with it. Neither is to be had in flight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp

import pecjax
from pecjax.envs.rooms import RoomsTask
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.maps import pick
from pecjax.envs.rooms.objectives import target
from pecjax.envs.rooms.path_fields import path_from
from pecjax.envs.rooms.rotations import heading
from pecjax.envs.spaces import Box
from pecjax.envs.task import World

SIDE, REACH, FAR = 16, 8.0, 2.0  # pixels; m to each side; m from a wall beyond which it is not shown


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
        config, (place, attitude) = state.config, (state.qpos[:2], state.qpos[3:])
        where = target(config, state.progress)
        way = path_from(params.paths, config.map_id, where, place, heading(attitude))
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
    """The rooms with the way, in spaces and tables of few goals a map."""

    task_kind: ClassVar = GuidedTask

    def make(self) -> tuple[Any, World]:
        """The task and its world, with the paths to all goals: of 10,000 maps in about half a minute."""
        task, world = super().make()
        space = self.named_space
        tables = [world.table] if space is None else [space.train.table, space.held_out.table]
        return task, self.with_paths(world, *tables)

    def for_training(self, world: World) -> World:
        """The world as it is: it has all paths."""
        return world
