"""docs/axis_pictures.py: every axis has a panel, and is varied alone, within its bounds."""

import dataclasses
import importlib.util
from pathlib import Path

import numpy as np
import pytest

import pecjax
from pecjax.envs.axes import axes_of

PATH = Path(__file__).parents[1] / "docs" / "axis_pictures.py"
SPEC = importlib.util.spec_from_file_location("axis_pictures", PATH)
pictures = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(pictures)

# Maps and objectives are groups, which spaces report apart; start and goal are those of the run.
ELSEWHERE = {"start", "goal", "map_id", "objective", "waypoint"}


def test_every_axis_has_a_panel():
    known = set(axes_of(type(pecjax.COORDINATE_SET_1)))
    assert {pictures.axis_of(name) for name in pictures.LEVELS} == known - ELSEWHERE


@pytest.mark.parametrize("name", pictures.LEVELS)
def test_an_axis_is_varied_alone(name):
    base = pictures.in_air(pecjax.COORDINATE_SET_1)
    levels = np.tile(np.asarray(pictures.LEVELS[name], float), 4)
    table = pictures.varied(base, name, levels)
    axis = pictures.axis_of(name)
    about = axes_of(type(table))[axis]
    assert about.low <= levels.min() and levels.max() <= about.high
    for field in dataclasses.fields(table):
        before, after = getattr(base, field.name), getattr(table, field.name)
        if field.name == axis:
            assert after.dtype == before.dtype and after.shape == before.shape
            flown = np.linalg.norm(after, axis=-1) if axis == "wind" else after
            np.testing.assert_allclose(flown, levels, rtol=1e-6)
        elif before is not None:
            np.testing.assert_array_equal(before, after)
