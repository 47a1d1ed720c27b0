"""Plans: floor plans as arrays, each with one flight and its measures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pecjax.envs.axes import make_table
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.maps import FAR_AWAY, MapBank

RADIUS, FLIGHT_HEIGHT = 0.25, 1.2  # m, of the drone in assets/rooms.xml and of `NavigationSettings`
CELL = 0.2  # m, of the grid on which plans are measured


class Plans(NamedTuple):
    """M floor plans of boxes along the axes, in metres and whole centimetres.

    Attributes:
        lower, upper: (M, W, 3) float32, opposite corners: floor, ceiling, four outer walls, inner walls,
            furniture. Boxes of no size far away fill up plans that have fewer than W.
        bounds: (M, 2, 2) float32, lower and upper corner in x and y.
        start, goal: (M, 2) float32.
        family: (M,) int32, the place of each plan's family in `names`.
        geodesic: (M,) float32 m, the length of the shortest path from start to goal for the drone's sphere
            at its flight height, as `geodesics` finds it.
        narrowest: (M,) float32 m, the diameter of the widest sphere that can roll at the flight height
            from a place where it covers the start to one where it covers the goal, at most twice the
            height; up to a cell of 0.2 m less than it is where passages lie off the lattice.
        doors: (M,) int32, how many doorways the shortest path goes through: gaps of at most 2 m between
            two walls on one line (`measures.doorways`).
        names: of the families.
    """

    lower: np.ndarray
    upper: np.ndarray
    bounds: np.ndarray
    start: np.ndarray
    goal: np.ndarray
    family: np.ndarray
    geodesic: np.ndarray
    narrowest: np.ndarray
    doors: np.ndarray
    names: tuple[str, ...]

    @property
    def size(self) -> int:
        """M, the number of plans."""
        return len(self.lower)

    @property
    def straight(self) -> np.ndarray:
        """(M,) m from start to goal as the crow flies."""
        return np.linalg.norm(self.goal - self.start, axis=-1)

    @property
    def detour(self) -> np.ndarray:
        """(M,) how many times longer the shortest path is than the straight line, 1 where it is straight."""
        return self.geodesic / self.straight

    @property
    def bank(self) -> MapBank:
        """The plans as a task's maps."""
        return MapBank(self.lower, self.upper, self.bounds)

    @property
    def configurations(self) -> Configurations:
        """A configuration for each plan, and its reverse: rows 2 i and 2 i + 1 are flown in plan i."""
        ends = np.stack([self.start, self.goal], axis=1)
        return make_table(
            Configurations,
            start=ends.reshape(-1, 2),
            goal=ends[:, ::-1].reshape(-1, 2),
            map_id=np.repeat(np.arange(self.size), 2),
        )

    def boxes(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """The corners (w, 3) m of one plan's boxes, without those that fill it up."""
        there = self.lower[number, :, 0] < FAR_AWAY
        return self.lower[number, there], self.upper[number, there]

    def some(self, chosen: slice | np.ndarray) -> Plans:
        """The plans that are chosen."""
        return Plans(*(array[chosen] for array in self[:-1]), names=self.names)


def join(parts: list[Plans]) -> Plans:
    """All plans of several lots of the same families, in order."""
    arrays = zip(*(part[:-1] for part in parts), strict=True)
    return Plans(*(np.concatenate(array) for array in arrays), names=parts[0].names)
