"""Generating plans: the same seed gives the same plans, whoever makes them and however many."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from pecjax.envs.rooms.geodesics import Paths, Way, search, straight_way, way_on_grid
from pecjax.envs.rooms.maps import FAR_AWAY
from pecjax.envs.rooms.plans.families import FAMILIES, MAX_BOXES, Family, check_family
from pecjax.envs.rooms.plans.furniture import draw_furniture
from pecjax.envs.rooms.plans.layout import HALF_WALL, HEIGHT, SLAB, Layout, draw_layout, outer_walls
from pecjax.envs.rooms.plans.measures import Measures, measure, plan_paths
from pecjax.envs.rooms.plans.plans import RADIUS, Plans, join
from pecjax.envs.rooms.plans.workers import chunks_of, over_chunks
from pecjax.errors import InputError

MARGIN = 0.15  # m, that start and goal are clear of walls beyond the drone's radius
MIN_PASSAGE = 0.75  # m, of the widest way between them; furniture may stand closer than that elsewhere
MAX_PLANS = 2**20
_TRIES, _STARTS = 40, 4  # layouts that are drawn for a plan, and starts that are tried in each


def make_plans(number: int, seed: int = 0, families: Sequence[Family] = FAMILIES, workers: int = 1) -> Plans:
    """Makes floor plans, each with one flight that can be flown.

    Plan i is of family i modulo their number and depends on the seed, i and the families alone: the first
    100 of 1,000 plans are the 100 plans of the same seed.

    Args:
        number: of plans.
        seed: from 0 on.
        families: dealt in turn.
        workers: processes that share the work. With more than one, a script needs the usual
            `if __name__ == "__main__":`.

    Returns:
        plans of `MAX_BOXES` boxes each, filled up.

    Raises:
        InputError: a family that cannot be made, or numbers that make no sense.
    """
    if not 1 <= number <= MAX_PLANS:
        raise InputError(f"number is {number}; 1 to {MAX_PLANS:,} plans can be made")
    if not 0 <= seed < 2**63:
        raise InputError(f"seed is {seed}; give a whole number from 0 to 2⁶³ - 1")
    if not families:
        raise InputError("no families; give at least one")
    for family in families:
        check_family(family)
    return join(over_chunks(functools.partial(_some, seed, tuple(families)), chunks_of(number), workers))


def _some(seed: int, families: tuple[Family, ...], chunk: tuple[int, int]) -> Plans:
    """The plans of a chunk."""
    number = chunk[1] - chunk[0]
    lower, upper = (np.full((number, MAX_BOXES, 3), FAR_AWAY, np.float32) for _ in range(2))
    bounds, ends = (np.zeros((number, 2, 2), np.float32) for _ in range(2))
    names = tuple(dict.fromkeys(family.name for family in families))
    kinds, measures = [], []
    for row, plan in enumerate(range(*chunk)):
        family = families[plan % len(families)]
        boxes, ends[row], measured = draw_plan(np.random.default_rng([seed, plan]), family)
        lower[row, : len(boxes)], upper[row, : len(boxes)] = boxes[:, 0], boxes[:, 1]
        bounds[row] = boxes[0, :, :2]
        kinds.append(names.index(family.name))
        measures.append(measured)
    geodesic, narrowest, doors = map(np.array, zip(*measures, strict=True))
    return Plans(
        lower=lower,
        upper=upper,
        bounds=bounds,
        start=ends[:, 0],
        goal=ends[:, 1],
        family=np.array(kinds, np.int32),
        geodesic=geodesic.astype(np.float32),
        narrowest=narrowest.astype(np.float32),
        doors=doors.astype(np.int32),
        names=names,
    )


def draw_plan(draw: np.random.Generator, family: Family) -> tuple[np.ndarray, np.ndarray, Measures]:
    """Draws one plan, anew until there is a flight in it.

    Returns:
        its boxes (w, 2, 3) float32 m, start and goal (2, 2) float32 m, its measures.

    Raises:
        InputError: there is no flight in any of many layouts.
    """
    for _ in range(_TRIES):
        boxes = _draw_boxes(draw, family)
        paths = plan_paths(boxes[:, 0], boxes[:, 1], boxes[0, :, :2])
        way = _draw_flight(draw, paths, family.apart)
        if way is not None:
            measured = measure(paths, boxes[:, 0], boxes[:, 1], way)
            if measured.narrowest >= MIN_PASSAGE:
                return boxes, way.points[[0, -1]].astype(np.float32), measured
    raise InputError(
        f"family '{family.name}' cannot be made: in {_TRIES} layouts no start and goal are {family.apart:g} "
        f"m apart and joined by a path {MIN_PASSAGE:g} m wide; ask for less furniture or a shorter way"
    )


def _draw_boxes(draw: np.random.Generator, family: Family) -> np.ndarray:
    """Floor, ceiling, outer walls, inner walls and furniture, (w, 2, 3) float32 m."""
    layout = draw_layout(draw, family)
    walls = np.concatenate([outer_walls(layout), layout.walls])
    furniture = draw_furniture(draw, family, layout, MAX_BOXES - 2 - len(walls))
    boxes = np.concatenate([_slabs(layout), _raise(walls), furniture])
    return (boxes.reshape(-1, 2, 3) / 100).astype(np.float32)


def _slabs(layout: Layout) -> np.ndarray:
    """Floor and ceiling (2, 6) cm, as far as the outer walls reach."""
    right, top = (int(along[-1]) + HALF_WALL for along in layout.lines)
    low = -HALF_WALL
    return np.array([(low, low, -SLAB, right, top, 0), (low, low, HEIGHT, right, top, HEIGHT + SLAB)])


def _raise(walls: np.ndarray) -> np.ndarray:
    """Walls (n, 4) from above as boxes (n, 6) cm from floor to ceiling."""
    height = np.array([[0, HEIGHT]]).repeat(len(walls), axis=0)
    return np.concatenate([walls[:, :2], height[:, :1], walls[:, 2:], height[:, 1:]], axis=1)


def _draw_flight(draw: np.random.Generator, paths: Paths, apart: float) -> Way | None:
    """The shortest path between a random start and goal, if there are any."""
    nodes = np.flatnonzero(paths.grid.clearance[paths.number >= 0] > RADIUS + MARGIN)
    # In whole centimetres as they are kept, so that who reads them measures the same.
    places = np.round(paths.places[nodes], 2).astype(np.float32).astype(np.float64)
    for _ in range(_STARTS if len(nodes) else 0):
        start = places[draw.integers(len(nodes))]
        far = np.linalg.norm(places - start, axis=1) >= apart
        if not far.any():
            continue
        (distances,), (before,) = search(paths, start[None])
        reached = np.flatnonzero(far & np.isfinite(distances[nodes]))
        if len(reached):
            goal = places[reached[draw.integers(len(reached))]]
            return straight_way(paths, start, goal) or way_on_grid(paths, start, goal, distances, before)
    return None
