"""Elsewhere: in which maps and configurations a policy is to be evaluated."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.rooms.spaces.pairs import make_site, table_lengths
from pecjax.envs.rooms.spaces.space import SPLITS, Space, shared_rows
from pecjax.envs.task import EvalSet, World, take_configs
from pecjax.errors import InputError

MOST_PATHS = 2000  # configurations up to which shortest paths are looked for


def evaluated_rooms(
    own: Rooms,
    trained_in: World,
    space: str | None = None,
    split: str | None = None,
    coordinates: str | None = None,
    maps: tuple[str, ...] | None = None,
) -> tuple[World, EvalSet]:
    """The world and the configurations that are asked for, by default those of the run.

    Args:
        own, trained_in: the run's task and its world.
        space: a named space or the file of one, and its `split`, held-out where it is not given.
        coordinates, maps: in place of a space, as `Rooms` has them.

    Raises:
        InputError: what is asked for does not go together or is not there, is of another version than the
            run was trained in, or has held-out configurations that are in the run's training table.
    """
    of_table = coordinates is not None or bool(maps)
    if space is not None and of_table:
        raise InputError(
            "a space has maps and configurations of its own; give it, or --coordinates and --scene"
        )
    if split is not None and split not in SPLITS:
        raise InputError(f"split is '{split}'; give {' or '.join(SPLITS)}")
    if split is not None and space is None and (own.space is None or of_table):
        raise InputError("a split is one of a space; give --space too")
    other = own
    if space is not None:
        other = dataclasses.replace(own, space=space, table=None, maps=())
    elif of_table:
        kept = maps or (own.maps if own.space is None else ())
        other = dataclasses.replace(own, space=None, table=coordinates or own.table, maps=kept)
    world = trained_in if other is own else other.make()[1]
    if other.space is None:
        return world, EvalSet(world.table, shortest=_shortest(other, world))
    before, found = own.named_space, other.named_space
    if before is not None and found is not None:
        _check_version(before, found)
    eval_set = other.eval_set(world, split or SPLITS[1])
    if eval_set.held_out and other is not own:
        _check_held_out(trained_in, world, eval_set.table)
    return world, eval_set


def _check_version(trained_in: Space, asked_for: Space) -> None:
    if trained_in.name == asked_for.name and trained_in.version != asked_for.version:
        raise InputError(
            f"space {asked_for.name}: version {asked_for.version} is asked for, and the run was trained in "
            f"{trained_in.version}; leave out --space to evaluate it in its own"
        )


def _check_held_out(trained_in: World, world: World, table: Configurations) -> None:
    """Where the maps are the same no configuration may be one that was trained in."""
    same = jax.tree.map(np.array_equal, trained_in.params.bank, world.params.bank)
    shared = shared_rows(table, trained_in.table) if all(same) else np.zeros(0)
    if shared.size:
        raise InputError(
            f"{shared.size} of the held-out configurations are in the run's training table, the first is row "
            f"{shared[0]}; a policy cannot be compared in what it was trained in"
        )


def _shortest(rooms: Rooms, world: World) -> np.ndarray | None:
    """The lengths (N,) m of the shortest paths that succeed, None where there are too many.

    Nor are they known where the grid is too coarse for a door that the drone fits through, or the map too
    large for it.
    """
    table = world.table
    if table.size > MOST_PATHS:
        return None
    lengths = np.zeros(table.size, np.float32)
    for number in np.unique(np.asarray(table.map_id)):
        scene, rows = rooms.scenes()[number], np.flatnonzero(np.asarray(table.map_id) == number)
        try:
            site = make_site(scene.map, scene.drone_radius, rooms.flight_height)
            lengths[rows] = table_lengths(site, take_configs(table, rows))
        except InputError:
            return None
    return np.maximum(lengths - rooms.goal_radius, 0)
