"""Checking plans: whatever a file says of its plans is found again from their boxes."""

from __future__ import annotations

import numpy as np

from pecjax.envs.rooms.clearance_grid import clearance_along
from pecjax.envs.rooms.geodesics import Paths, shortest_ways
from pecjax.envs.rooms.plans.measures import measure, plan_paths
from pecjax.envs.rooms.plans.plans import FLIGHT_HEIGHT, RADIUS, Plans
from pecjax.envs.rooms.plans.workers import chunks_of, over_chunks
from pecjax.errors import InputError

_TOLERANCE = 1e-3  # m


def check_plans(plans: Plans, workers: int = 1) -> None:
    """Makes sure that every plan is closed, that its flight can be flown, and that its measures are right.

    Args:
        workers: as for `make_plans`.

    Raises:
        InputError: the first plan that is wrong, and what is.
    """
    chunks = [(begin, plans.some(slice(begin, end))) for begin, end in chunks_of(plans.size)]
    for found in over_chunks(_first_wrong, chunks, workers):
        if found:
            raise InputError(found)


def _first_wrong(chunk: tuple[int, Plans]) -> str:
    """The first plan at fault of those from a number on; empty if there is none."""
    begin, plans = chunk
    for number in range(plans.size):
        if wrong := _wrong(plans, number):
            return f"plan {begin + number}: {wrong}"
    return ""


def _wrong(plans: Plans, number: int) -> str:
    """What is wrong with one plan; empty if nothing is."""
    lower, upper = plans.boxes(number)
    paths = plan_paths(lower, upper, plans.bounds[number])
    if not _is_closed(paths, lower, upper, plans.bounds[number]):
        return "it is not closed all around; make it anew"
    ends = np.stack([plans.start[number], plans.goal[number]]).astype(np.float64)
    if np.any((ends < plans.bounds[number][0]) | (ends > plans.bounds[number][1])):
        return "start or goal lies outside; make it anew"
    gaps = clearance_along(paths.grid, ends, ends)
    if np.any(gaps <= RADIUS):
        role, point = ("start", ends[0]) if gaps[0] <= RADIUS else ("goal", ends[1])
        return f"its {role} ({point[0]:g}, {point[1]:g}) lies {gaps.min():.2f} m from a wall; make it anew"
    (way,) = shortest_ways(paths, ends[:1], ends[1:])
    if not np.isfinite(way.length):
        return "no path leads from its start to its goal; make it anew"
    found = measure(paths, lower, upper, way)
    for name, value in found._asdict().items():
        written = float(getattr(plans, name)[number])
        if abs(value - written) > _TOLERANCE:
            return f"its {name} is {value:g}, and {written:g} is written; make it anew"
    return ""


def _is_closed(paths: Paths, lower: np.ndarray, upper: np.ndarray, bounds: np.ndarray) -> bool:
    """Whether no free place lies at the border, and a floor and a ceiling cover all."""
    free = paths.number >= 0
    border = free[[0, -1]].any() or free[:, [0, -1]].any()
    covers = np.all((lower[:, :2] <= bounds[0]) & (upper[:, :2] >= bounds[1]), axis=1)
    floor, ceiling = covers & (upper[:, 2] <= 0), covers & (lower[:, 2] >= FLIGHT_HEIGHT)
    return bool(not border and floor.any() and ceiling.any())
