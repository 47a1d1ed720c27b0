"""Random maps of 64 boxes as pecjax makes none: open to the sky, or with walls that end below the ceiling."""

import numpy as np

from pecjax.envs.rooms.map_file import Map

SIZE, HEIGHT, THICK, DOOR = 20.0, 2.5, 0.1, 1.2  # m: sides, height, half a wall's thickness, a door's width
BOXES = 64


def _lines(draw):
    """Five irregular places, of which the outer are the map's edges."""
    return np.array([0, *(np.arange(1, 4) * SIZE / 4 + draw.uniform(-0.9, 0.9, 3)), SIZE]) - SIZE / 2


def _open_sides(draw):
    """Whether there is a door from each room to the next in x and in y: all rooms are joined."""
    sides = [(axis, i, j) for axis in (0, 1) for i in range(4 - (axis == 0)) for j in range(4 - (axis == 1))]
    group = np.arange(16).reshape(4, 4)
    doors = set()
    for side in draw.permutation(sides):
        axis, i, j = side
        a, b = group[i, j], group[i + (axis == 0), j + (axis == 1)]
        if a != b or draw.random() < 0.25:
            doors.add(tuple(side))
            group[group == b] = a
    return sides, doors


def floor_plan(seed, lids=True, uneven=False):
    """A map of at most `BOXES` boxes; without floor and ceiling, or with walls of several heights."""
    draw = np.random.default_rng(seed)
    xs, ys = _lines(draw), _lines(draw)
    boxes, e, h = [], SIZE / 2, HEIGHT
    for low in (-e - THICK, e - THICK):
        boxes.append([low, -e, 0, low + 2 * THICK, e, h])
        boxes.append([-e, low, 0, e, low + 2 * THICK, h])
    if lids:
        boxes += [[-e, -e, -0.1, e, e, 0], [-e, -e, h, e, e, h + 0.1]]
    sides, doors = _open_sides(draw)
    for axis, i, j in sides:
        across, ends = (xs[i + 1], ys[j : j + 2]) if axis == 0 else (ys[j + 1], xs[i : i + 2])
        top = draw.choice([h, 1.4, 0.9]) if uneven else h
        pieces = [tuple(ends)]
        if (axis, i, j) in doors:
            door = draw.uniform(ends[0] + 0.3, ends[1] - 0.3 - DOOR)
            pieces = [(ends[0], door), (door + DOOR, ends[1])]
        for a, b in pieces:
            low, high = [across - THICK, a], [across + THICK, b]
            order = slice(None, None, 1 if axis == 0 else -1)
            boxes.append([*low[order], 0, *high[order], top])
    while len(boxes) < BOXES:
        room = draw.integers(0, 4, 2)
        half = draw.uniform(0.15, 0.5, 3)
        low = np.array([xs[room[0]], ys[room[1]]]) + 0.4 + half[:2]
        high = np.array([xs[room[0] + 1], ys[room[1] + 1]]) - 0.4 - half[:2]
        middle = [*draw.uniform(low, high), draw.choice([half[2], 1.2, h - half[2]])]
        boxes.append([*(middle - half), *(middle + half)])
    corners = np.array(boxes[:BOXES])
    low, high = corners[:, :2].min(axis=0), corners[:, 3:5].max(axis=0)
    return Map(corners[:, :3], corners[:, 3:], np.stack([low, high]), ("box",) * len(corners))
