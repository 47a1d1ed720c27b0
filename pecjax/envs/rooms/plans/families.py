"""Families of floor plans: the ranges that a plan's rooms, doors and furniture are drawn from."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

from pecjax.errors import InputError, nearest

MAX_BOXES = 64
WALL = 0.2  # m thick
JAMB = 0.2  # m, the least that is left of a wall on each side of a door
MIN_DOOR = 0.8  # m
MAX_SIZE = 50.0  # m
LATTICE = 0.2  # m, between the lines on which walls may stand; the middle of a door lies between two
_NARROWEST_ROOM = 1.4  # m from wall line to wall line
_SHELL = 6  # floor, ceiling and four outer walls

Range = tuple[float, float]
Count = tuple[int, int]


@dataclass(frozen=True)
class Family:
    """What the plans of one family have in common; each range is drawn from evenly, both ends included.

    Attributes:
        name: of the family.
        size: m, each side of the map, from outer wall to outer wall.
        columns, rows: how many rooms lie side by side.
        corridor: m, how wide a corridor across the map is, from wall line to wall line; none where 0.
        door: m, how wide doors are.
        extra_doors: doors beyond those that join all rooms in one way only.
        open_share: share of the doors that are as wide as the wall that they are in.
        pillars: from floor to ceiling.
        low: cabinets and tables, which the drone flies over.
        shelves: along walls, some of which it flies over.
        hanging: lamps and beams, some of which it flies under.
        apart: m, the least straight distance between start and goal.
    """

    name: str
    size: Range = (16.0, 20.0)
    columns: Count = (1, 1)
    rows: Count = (1, 1)
    corridor: Range = (0.0, 0.0)
    door: Range = (1.4, 1.8)
    extra_doors: Count = (0, 0)
    open_share: float = 0.0
    pillars: Count = (0, 0)
    low: Count = (0, 0)
    shelves: Count = (0, 0)
    hanging: Count = (0, 0)
    apart: float = 6.0


# From easy to hard, by the detours that they ask for (docs/maps.md has their figures).
FAMILIES = (
    Family("hall", pillars=(12, 30), low=(0, 4), hanging=(0, 3)),
    Family(
        "rooms", columns=(2, 3), rows=(2, 3), door=(1.4, 2.0), extra_doors=(1, 3), pillars=(0, 3), low=(0, 4)
    ),
    Family(
        "furnished",
        columns=(2, 3),
        rows=(2, 3),
        door=(1.2, 1.6),
        extra_doors=(0, 2),
        pillars=(0, 3),
        low=(4, 9),
        shelves=(5, 11),
        hanging=(3, 7),
    ),
    Family(
        "corridor",
        columns=(3, 5),
        rows=(2, 2),
        corridor=(1.8, 2.4),
        door=(1.0, 1.4),
        low=(2, 6),
        shelves=(2, 6),
        hanging=(0, 3),
    ),
    Family(
        "apartment",
        columns=(3, 4),
        rows=(3, 4),
        door=(0.9, 1.1),
        extra_doors=(0, 2),
        open_share=0.15,
        low=(3, 8),
        shelves=(3, 8),
        hanging=(1, 4),
    ),
    Family(
        "maze", columns=(5, 6), rows=(5, 6), door=(0.9, 1.4), extra_doors=(0, 1), open_share=0.4, apart=8.0
    ),
)


def find_families(names: Sequence[str]) -> tuple[Family, ...]:
    """Families of ours by their names, in that order; one that stands twice is dealt twice.

    Raises:
        InputError: no such family.
    """
    known = {family.name: family for family in FAMILIES}
    for name in names:
        if name not in known:
            raise InputError(
                f"unknown family '{name}'{nearest(name, [*known])}; choose among {', '.join(known)}"
            )
    return tuple(known[name] for name in names)


def spare_walls(columns: int, rows: int, corridor: bool) -> int:
    """How many walls between rooms are left when all rooms are joined in one way only."""
    lines = rows + corridor
    walls = (columns - 1) * lines + columns * (lines - 1)
    return walls - (columns * lines - 1)


def check_family(family: Family) -> None:
    """Makes sure that a family asks for what can be.

    Raises:
        InputError: it does not; with its name and numbers.
    """
    for field in dataclasses.fields(family)[1:]:
        value = getattr(family, field.name)
        low, high = value if isinstance(value, tuple) else (value, value)
        if not 0 <= low <= high <= 1000:
            raise _refused(family, f"{field.name} is {value}; give numbers that rise from 0 or more")
    if family.open_share > 1:
        raise _refused(family, f"open_share is {family.open_share:g}; give a share from 0 to 1")
    if family.size[1] > MAX_SIZE:
        raise _refused(family, f"size is up to {family.size[1]:g} m; {MAX_SIZE:g} m is the most")
    if min(family.columns[0], family.rows[0]) < 1:
        raise _refused(family, "it has no rooms; give at least 1 column and 1 row")
    if family.door[0] < MIN_DOOR:
        raise _refused(family, f"doors are {family.door[0]:g} m wide; {MIN_DOOR:g} m is the least")
    if family.corridor[1] > 0 and family.corridor[0] < _NARROWEST_ROOM:
        raise _refused(
            family, f"corridors are {family.corridor[0]:g} m wide; {_NARROWEST_ROOM:g} m is the least"
        )
    _check_rooms(family)


def _check_rooms(family: Family) -> None:
    """Whether rooms, doors and boxes fit into the smallest map of the family."""
    hall = family.columns[1] == family.rows[1] == 1 and not family.corridor[1]
    for side, number in (("columns", family.columns[1]), ("rows", family.rows[1])):
        room = (family.size[0] - family.corridor[1]) / number
        least = least_room(family) if not hall else _NARROWEST_ROOM
        if room < least - 1e-9:
            raise _refused(
                family,
                f"{number} {side} in {family.size[0]:g} m leave {room:.3g} m each, and a wall with a door of "
                f"{family.door[1]:g} m needs {least:g} m",
            )
    spare = spare_walls(family.columns[0], family.rows[0], family.corridor[1] > 0)
    if family.extra_doors[0] > spare:
        raise _refused(
            family,
            f"it asks for {family.extra_doors[0]} extra doors, and {family.columns[0]} by {family.rows[0]} "
            f"rooms have {spare} walls to spare",
        )
    boxes = most_boxes(family)
    if boxes > MAX_BOXES:
        raise _refused(family, f"its walls may be {boxes} boxes; {MAX_BOXES} is the most of a map")


def least_room(family: Family) -> float:
    """How far apart (m) two wall lines must be, so that the widest door fits on the lattice between them."""
    least = max(family.door[1] + WALL + 2 * JAMB + LATTICE, _NARROWEST_ROOM)
    return LATTICE * math.ceil(least / LATTICE - 1e-6)


def most_boxes(family: Family) -> int:
    """The most boxes that walls, floor and ceiling can be: each line is cut by the doors in it."""
    columns, lines = family.columns[1], family.rows[1] + (family.corridor[1] > 0)
    doors = columns * lines - 1 + min(
        family.extra_doors[1], spare_walls(columns, family.rows[1], family.corridor[1] > 0)
    )  # fmt: skip
    return _SHELL + (columns - 1) + (lines - 1) + doors


def _refused(family: Family, why: str) -> InputError:
    return InputError(f"family '{family.name}' cannot be made: {why}")
