"""Layouts: rooms between irregular lines, joined by doors; all lengths in whole centimetres."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pecjax.envs.rooms.plans.families import JAMB, LATTICE, WALL, Family, least_room

HEIGHT = 250  # cm, from floor to ceiling
SLAB = 10  # cm, how thick floor and ceiling are
_LATTICE = round(100 * LATTICE)
HALF_WALL = round(50 * WALL)
_JAMB = round(100 * JAMB)


class Layout(NamedTuple):
    """A plan without furniture, in cm; its outer walls stand around (0, 0).

    Attributes:
        lines: where walls may stand in x and in y, the outer ones included.
        walls: (n, 4) lower x, y and upper x, y.
        doors: (d, 4) the same of the gaps in walls.
    """

    lines: tuple[np.ndarray, np.ndarray]
    walls: np.ndarray
    doors: np.ndarray


class _Side(NamedTuple):
    """The wall between two rooms: on a line of one axis, between two lines of the other."""

    axis: int
    line: int
    along: int
    rooms: tuple[int, int]


def draw_layout(draw: np.random.Generator, family: Family) -> Layout:
    """Draws rooms and their doors: a random tree joins all rooms, a few more doors make loops."""
    columns, rows = (int(draw.integers(low, high + 1)) for low, high in (family.columns, family.rows))
    corridor = family.corridor[1] > 0
    least = least_room(family) if max(columns, rows) > 1 or corridor else 0
    sizes = [_multiple(draw, *family.size, _LATTICE) for _ in range(2)]
    xs = _lines(draw, sizes[0], columns, least)
    strip = _multiple(draw, *family.corridor, _LATTICE)
    ys = _lines(draw, sizes[1] - strip, rows, least)
    middle = rows // 2
    if corridor:
        ys = np.concatenate([ys[: middle + 1], ys[middle:] + strip])
    lines = (xs, ys)
    gaps = _gaps(draw, family, lines, middle if corridor else -1)
    walls = [wall for axis in range(2) for wall in _walls(lines, axis, gaps[axis])]
    doors = [door for axis in range(2) for line in gaps[axis] for door in gaps[axis][line]]
    upright = [np.array([_upright(*part) for part in parts], np.int64) for parts in (walls, doors)]
    turned = draw.random() < 0.5  # the corridor, say, goes from south to north
    order = [1, 0, 3, 2] if turned else [0, 1, 2, 3]
    return Layout((ys, xs) if turned else (xs, ys), *(part.reshape(-1, 4)[:, order] for part in upright))


def outer_walls(layout: Layout) -> np.ndarray:
    """The four walls (4, 4) cm around the map."""
    right, top = (int(along[-1]) for along in layout.lines)
    half = HALF_WALL
    return np.array([
        (-half, -half, half, top + half),
        (right - half, -half, right + half, top + half),
        (-half, -half, right + half, half),
        (-half, top - half, right + half, top + half),
    ])  # fmt: skip


def _multiple(draw: np.random.Generator, low: float, high: float, of: int) -> int:
    """A length in cm between two in m, a multiple of `of` as far as these allow it."""
    first, last = -(-round(100 * low) // of), round(100 * high) // of
    return int(draw.integers(first, max(first, last) + 1)) * of


def _lines(draw: np.random.Generator, size: int, parts: int, least: float) -> np.ndarray:
    """The ends of so many parts of a length (cm), each at least `least` m.

    Parts are at least as long as the mean of that and of equal parts; the rest is spread at random.
    """
    smallest = (-(-round(100 * least) // _LATTICE) + size // _LATTICE // parts) // 2
    spare = size // _LATTICE - parts * smallest
    cuts = np.sort(draw.integers(0, spare + 1, parts - 1))
    inner = _LATTICE * (cuts + smallest * np.arange(1, parts))
    return np.concatenate([[0], inner, [size]]).astype(np.int64)


def _sides(columns: int, lines: int) -> list[_Side]:
    """The walls between rooms, which are counted along y first."""
    across = [
        _Side(0, i + 1, j, (i * lines + j, (i + 1) * lines + j))
        for i in range(columns - 1)
        for j in range(lines)
    ]
    upwards = [
        _Side(1, j + 1, i, (i * lines + j, i * lines + j + 1))
        for i in range(columns)
        for j in range(lines - 1)
    ]
    return across + upwards


def _gaps(
    draw: np.random.Generator, family: Family, lines: tuple[np.ndarray, np.ndarray], corridor: int
) -> list[dict[int, list[tuple[int, int, int, int]]]]:
    """The doors of each line, by axis: (axis, line, from, to)."""
    columns, across = len(lines[0]) - 1, len(lines[1]) - 1
    sides = _sides(columns, across)
    open_sides = [side for side in sides if side.axis == 0 and side.along == corridor]
    others = [side for side in sides if side not in open_sides]
    order = [*open_sides, *(others[i] for i in draw.permutation(len(others)))]
    group = list(range(columns * across))
    chosen, left = [], []
    for side in order:  # Kruskal's spanning tree of walls in random order
        one, other = (group[room] for room in side.rooms)
        (left if one == other else chosen).append(side)
        if one != other:
            group = [one if member == other else member for member in group]
    spare = min(int(draw.integers(family.extra_doors[0], family.extra_doors[1] + 1)), len(left))
    gaps: list[dict[int, list[tuple[int, int, int, int]]]] = [{}, {}]
    for side in chosen + left[:spare]:
        begin, end = (int(lines[1 - side.axis][side.along + k]) for k in range(2))
        whole = draw.random() < family.open_share or side in open_sides
        span = (begin + HALF_WALL, end - HALF_WALL) if whole else _door(draw, family, begin, end)
        at = int(lines[side.axis][side.line])
        gaps[side.axis].setdefault(side.line, []).append((side.axis, at, *span))
    return gaps


def _door(draw: np.random.Generator, family: Family, begin: int, end: int) -> tuple[int, int]:
    """A door's two ends (cm) in the wall between two lines; its middle lies between two of the lattice."""
    width = _multiple(draw, *family.door, 10)
    margin = HALF_WALL + _JAMB + width / 2
    first = int(np.ceil((begin + margin - _LATTICE / 2) / _LATTICE))
    last = int(np.floor((end - margin - _LATTICE / 2) / _LATTICE))
    middle = _LATTICE * int(draw.integers(first, max(first, last) + 1)) + _LATTICE // 2
    return middle - width // 2, middle - width // 2 + width


def _walls(
    lines: tuple[np.ndarray, np.ndarray], axis: int, gaps: dict[int, list[tuple[int, int, int, int]]]
) -> list[tuple[int, int, int, int]]:
    """What the doors leave of the inner lines of one axis, (axis, line, from, to) each."""
    walls = []
    for line in range(1, len(lines[axis]) - 1):
        at, end = int(lines[axis][line]), int(lines[1 - axis][-1])
        doors = sorted(gaps.get(line, []), key=lambda door: door[2])
        edges = [0, *(edge for door in doors for edge in door[2:]), end]
        # What stands between two open sides is within the wall that crosses, or nothing is there.
        pieces = zip(edges[::2], edges[1::2], strict=True)
        walls.extend((axis, at, low, high) for low, high in pieces if high - low > 2 * HALF_WALL)
    return walls


def _upright(axis: int, at: int, low: int, high: int) -> tuple[int, int, int, int]:
    across = (at - HALF_WALL, at + HALF_WALL)
    (x, right), (y, top) = (across, (low, high)) if axis == 0 else ((low, high), across)
    return x, y, right, top
