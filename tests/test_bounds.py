"""benchmarks/bounds.py: the way that `Guided` shows, in a room with a wall across it."""

import importlib.util
import sys
from pathlib import Path

import numpy as np

FILE = Path(__file__).parents[1] / "benchmarks" / "bounds.py"
SPEC = importlib.util.spec_from_file_location("bounds", FILE)
bounds = importlib.util.module_from_spec(SPEC)
sys.modules["bounds"] = bounds  # where its dataclasses look for their module
SPEC.loader.exec_module(bounds)

ROOM = np.float64([(0, 0), (10, 8)])
WALL = np.float64([(4.9, 0, 0)]), np.float64([(5.1, 6, 3)])  # the way past it is at y of 6 to 8
GOAL = np.float64([9, 1])


def shown(place, wall):
    """Bearing rad and length m at a place."""
    bearing, length = bounds._way_to(GOAL, *wall, ROOM, height=1.2, radius=0.2)
    cell = tuple(np.round(np.asarray(place) / bounds.CELL).astype(int))
    return bearing[cell] * 2 * np.pi / 256, length[cell] / 4


def test_in_the_open_the_way_is_straight():
    nothing = np.zeros((0, 3)), np.zeros((0, 3))
    for place in ((1, 1), (3, 6), (9, 7)):
        offset = GOAL - place
        bearing, length = shown(place, nothing)
        turn = bearing - np.arctan2(offset[1], offset[0])
        assert abs((turn + np.pi) % (2 * np.pi) - np.pi) < 0.25  # paths go from cell to cell
        np.testing.assert_allclose(length, np.linalg.norm(offset), rtol=0.1, atol=0.3)


def test_behind_a_wall_it_leads_around_it():
    bearing, length = shown((3, 1), WALL)
    to_the_gap, on_from_it = np.float64([2, 5.5]), np.float64([4, 5.5])
    assert abs(bearing - np.arctan2(to_the_gap[1], to_the_gap[0])) < 0.4
    around = np.linalg.norm(to_the_gap) + np.linalg.norm(on_from_it)
    np.testing.assert_allclose(length, around, rtol=0.1)
    past, _ = shown((6, 6.5), WALL)
    assert past < -0.8  # and down to the goal
