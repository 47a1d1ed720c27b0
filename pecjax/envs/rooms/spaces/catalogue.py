"""The catalogue of named spaces: what each is made of, from a fixed seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from pecjax.envs.axes import make_table
from pecjax.envs.rooms.config import COORDINATE_SET_1, COORDINATE_SET_2, OBJECTIVES, VIA, Configurations
from pecjax.envs.rooms.maps import MapBank
from pecjax.envs.rooms.plans.families import FAMILIES
from pecjax.envs.rooms.plans.generate import make_plans
from pecjax.envs.rooms.plans.plans import Plans
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.scene import load_scene
from pecjax.envs.rooms.spaces import weather
from pecjax.envs.rooms.spaces.pairs import (
    Pairs,
    Site,
    draw_pairs,
    free_places,
    make_site,
    shortest,
    table_lengths,
)
from pecjax.envs.rooms.spaces.space import Part, Space
from pecjax.errors import InputError, nearest

LEAST = 3.0  # m between start and goal
FAR = 8.0  # m between start and goal of hard pairs
_WORKERS = 2  # processes that make floor plans; the plans do not depend on it


class Recipe(NamedTuple):
    """How a named space is made.

    Attributes:
        about: one line.
        version: the checksum of what is made.
        make: (name, about) -> the space.
    """

    about: str
    version: str
    make: Callable[[str, str], Space]


def make_space(name: str) -> Space:
    """Makes a named space.

    Raises:
        InputError: there is none of that name.
    """
    recipe = find_recipe(name)
    return recipe.make(name, recipe.about)


def find_recipe(name: str) -> Recipe:
    """The recipe of that name.

    Raises:
        InputError: there is none.
    """
    if name not in RECIPES:
        raise InputError(
            f"space '{name}' is unknown{nearest(name, [*RECIPES])}; give one of {', '.join(RECIPES)}, "
            "or a file of one"
        )
    return RECIPES[name]


def _six_rooms() -> Site:
    scene = load_scene()
    return make_site(scene.map, scene.drone_radius, NavigationSettings().flight_height)


def _part(pairs: Pairs, group: np.ndarray | None = None, **axes: Any) -> Part:
    table = make_table(Configurations, start=pairs.start, goal=pairs.goal, **axes)
    group = np.zeros(table.size) if group is None else group
    return Part(table, np.asarray(group, np.int32), pairs.shortest)


def _space(
    name: str, about: str, groups: tuple[str, ...], parts: Iterable[Part], maps: MapBank | None = None
) -> Space:
    train, held_out = parts
    return Space(name, about, groups, train, held_out, maps)


def _apart(distance: np.ndarray, in_sight: np.ndarray) -> np.ndarray:
    return distance >= LEAST


def _paper(table: Configurations) -> Callable[[str, str], Space]:
    """One of the paper's sets; held out are the same places, paired otherwise."""

    def make(name: str, about: str) -> Space:
        site, start, goal = _six_rooms(), np.asarray(table.start), np.asarray(table.goal)
        places = np.unique(np.concatenate([start, goal]), axis=0)
        first, second = (places[index] for index in np.nonzero(~np.eye(len(places), dtype=bool)))
        known = {tuple(pair) for pair in np.hstack([start, goal]).tolist()}
        new = np.array([tuple(pair) not in known for pair in np.hstack([first, second]).tolist()])
        new &= np.linalg.norm(second - first, axis=1) >= LEAST
        pairs = (Pairs(a, b, shortest(site, a, b)) for a, b in ((start, goal), (first[new], second[new])))
        return _space(name, about, ("all",), map(_part, pairs))

    return make


def _rooms_pairs(name: str, about: str) -> Space:
    site, draw = _six_rooms(), np.random.default_rng([15, 1])
    parts = (_part(draw_pairs(site, draw, number, _apart)) for number in (2000, 1000))
    return _space(name, about, ("all",), parts)


def _rooms_longtail(name: str, about: str) -> Space:
    site, draw = _six_rooms(), np.random.default_rng([15, 2])

    def easy(distance: np.ndarray, in_sight: np.ndarray) -> np.ndarray:
        return (distance >= LEAST) & in_sight

    def hard(distance: np.ndarray, in_sight: np.ndarray) -> np.ndarray:
        return (distance > FAR) & ~in_sight

    def part(numbers: tuple[int, int]) -> Part:
        drawn = [draw_pairs(site, draw, *of) for of in zip(numbers, (easy, hard), strict=True)]
        return _part(Pairs(*map(np.concatenate, zip(*drawn, strict=True))), np.repeat([0, 1], numbers))

    return _space(name, about, ("easy", "hard"), map(part, ((1900, 100), (400, 600))))


def _rooms_storm(name: str, about: str) -> Space:
    site, draw, vehicle = _six_rooms(), np.random.default_rng([15, 3]), load_scene().vehicle

    def part(number: int) -> Part:
        plain = _part(draw_pairs(site, draw, number, _apart), **weather.draw_weather(draw, number))
        return plain._replace(group=weather.groups_of(plain.table, vehicle, NavigationSettings()))

    return _space(name, about, weather.GROUPS, map(part, (2000, 1000)))


def _objectives(site: Site, draw: np.random.Generator, pairs: Pairs) -> Part:
    """The pairs with the objectives in turn, and a waypoint anywhere for those that lead by way of one."""
    objective = np.arange(len(pairs.start)) % len(OBJECTIVES)
    via = objective == VIA
    waypoint = np.where(via[:, None], free_places(site, draw, len(via)), np.float32(0))
    part = _part(pairs, objective, objective=objective, waypoint=waypoint)
    return part._replace(shortest=table_lengths(site, part.table))


def _tasks(name: str, about: str) -> Space:
    site, draw = _six_rooms(), np.random.default_rng([15, 4])
    parts = (_objectives(site, draw, draw_pairs(site, draw, number, _apart)) for number in (1800, 900))
    return _space(name, about, OBJECTIVES, parts)


def _plans_parts(trained: int, held_out: int, seed: int) -> tuple[Plans, list[np.ndarray]]:
    """Floor plans, and which of them each part has."""
    plans = make_plans(trained + held_out, seed, workers=_WORKERS)
    return plans, np.split(np.arange(plans.size), [trained])


def _floorplans(name: str, about: str) -> Space:
    plans, parts = _plans_parts(9000, 1000, 15)

    def part(numbers: np.ndarray) -> Part:
        of = plans.some(numbers)
        return _part(Pairs(of.start, of.goal, of.geodesic), of.family, map_id=numbers)

    return _space(name, about, plans.names, map(part, parts), plans.bank)


def _everything(name: str, about: str) -> Space:
    plans, parts = _plans_parts(2000, 500, 16)
    draw = np.random.default_rng([15, 5])

    def part(numbers: np.ndarray) -> Part:
        of, number = plans.some(numbers), len(numbers)
        # A waypoint is the start of the way back: to the goal and then to where it began.
        objective = draw.integers(0, len(OBJECTIVES), number)
        via = objective == VIA
        goal, waypoint = np.where(via[:, None], [of.start, of.goal], [of.goal, np.zeros_like(of.goal)])
        pairs = Pairs(of.start, goal.astype(np.float32), of.geodesic * np.where(via, 2, 1).astype(np.float32))
        return _part(
            pairs,
            of.family,
            map_id=numbers,
            objective=objective,
            waypoint=waypoint,
            **weather.draw_weather(draw, number),
            motor_strength=draw.uniform(0.85, 1, number).round(2),
            depth_noise=draw.uniform(0, 0.05, number).round(3),
            depth_dropout=draw.uniform(0, 0.1, number).round(3),
            latency=draw.integers(0, 3, number),
        )

    return _space(name, about, plans.names, map(part, parts), plans.bank)


RECIPES = {
    "paper-1": Recipe(
        "the paper's set 1; held out: the same places, paired otherwise",
        "0327cbb493ef",
        _paper(COORDINATE_SET_1),
    ),
    "paper-2": Recipe(
        "the paper's set 2; held out: the same places, paired otherwise",
        "4344fd0231d4",
        _paper(COORDINATE_SET_2),
    ),
    "rooms-pairs": Recipe("pairs in the six rooms, 3 m or more apart", "62ecc778877c", _rooms_pairs),
    "rooms-longtail": Recipe(
        "95 % of the pairs in clear sight, 5 % blocked and over 8 m apart; held out: 40 % and 60 %",
        "b4df82f2223a",
        _rooms_longtail,
    ),
    "rooms-storm": Recipe(
        "pairs in winds up to beyond what can be flown, with gusts, payload and fog",
        "95a4bc6b7405",
        _rooms_storm,
    ),
    "floorplans": Recipe(
        f"10,000 floor plans of {len(FAMILIES)} families, 1,000 of them held out", "9413e87767ed", _floorplans
    ),
    "tasks": Recipe("three objectives in the six rooms: reach, hold, via", "0a23d340922b", _tasks),
    "everything": Recipe(
        "2,500 floor plans, three objectives, weather, weak motors, a camera that errs, late actions",
        "f27238aacfba",
        _everything,
    ),
}
