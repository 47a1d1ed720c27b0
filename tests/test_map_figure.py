"""The map by what is drawn: what can be hit stands out, and nothing hides the rest."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from conftest import OTHER_MAP
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle

import pecjax
from pecjax.envs.rooms.config import Configurations
from pecjax.plotting import flights as flight_figures
from pecjax.plotting.flights import LOOKS
from pecjax.plotting.maps import floor_plan, rooms
from pecjax.plotting.success_map import success

# Beside the floor, the walls and the pillar of 1.4 m of OTHER_MAP.
MORE_WALLS = """
    <geom name="ceiling" type="box" pos="1 0 3.05" size="5 4 0.05"/>
    <geom name="table" type="box" pos="4 -2 0.3" size="0.8 0.5 0.3"/>
    <geom name="beam" type="box" pos="3 2.5 2.5" size="0.2 1.5 0.2"/>
    <geom name="touching" type="box" pos="-3 3 0.55" size="0.2 0.2 0.5"/>
    <geom name="under" type="box" pos="-3 2 0.5" size="0.2 0.2 0.5"/>
    <geom name="post" type="box" pos="4 -2 1" size="0.1 0.1 1"/>
"""
HATCHED = {"table", "beam", "under"}
COVERING = {"floor", "ceiling"}
TABLE = Configurations(np.array([[-2.0, 0], [4.5, 0]]), np.array([[4.0, 3], [-2, -2]]))


@pytest.fixture(scope="module")
def furnished(tmp_path_factory):
    path = tmp_path_factory.mktemp("maps") / "furnished.xml"
    path.write_text(OTHER_MAP.replace("<worldbody>", f"<worldbody>{MORE_WALLS}", 1))
    return pecjax.load_scene(path)


@pytest.fixture(scope="module")
def with_plane(furnished):
    """As of a floor without end: one more box, very wide."""
    wider = dataclasses.replace(
        furnished.map,
        lower=np.vstack([furnished.wall_lower, [-1e6, -1e6, -1.0]]),
        upper=np.vstack([furnished.wall_upper, [1e6, 1e6, 0.0]]),
        names=(*furnished.map.names, "plane"),
    )
    return dataclasses.replace(furnished, map=wider)


def drawn(scene):
    """The map's axes, and the rectangle of each wall by name."""
    axes = Figure().subplots()
    floor_plan(axes, scene.map, scene.drone_radius)
    walls = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    return axes, dict(zip(scene.map.names, walls, strict=True))


def filled(patch):
    return patch.get_facecolor()[3] > 0


def test_what_stands_at_the_flight_height_is_solid_and_the_rest_is_not(furnished):
    _, walls = drawn(furnished)
    for name, wall in walls.items():
        assert filled(wall) == (name not in HATCHED | COVERING), name
        assert bool(wall.get_hatch()) == (name in HATCHED), name
    # 0.15 m below the flight at 1.2 m is within the drone's radius of 0.18 m, 0.2 m is not.
    assert filled(walls["touching"]) and not filled(walls["under"])
    for name in HATCHED | COVERING:  # an outline, thin and light
        assert 0 < walls[name].get_linewidth() < 1 and min(walls[name].get_edgecolor()[:3]) > 0.5


def test_solid_walls_lie_above_hatched_ones_and_these_above_floors(furnished):
    _, walls = drawn(furnished)
    solid = {wall.get_zorder() for name, wall in walls.items() if name not in HATCHED | COVERING}
    hatched = {walls[name].get_zorder() for name in HATCHED}
    covers = {walls[name].get_zorder() for name in COVERING}
    assert max(covers) < min(hatched) and max(hatched) < min(solid)


def test_walls_stand_where_they_are(furnished):
    axes, walls = drawn(furnished)
    for lower, upper, wall in zip(furnished.wall_lower, furnished.wall_upper, walls.values(), strict=True):
        np.testing.assert_allclose(wall.get_bbox().get_points(), [lower[:2], upper[:2]])
    assert axes.get_xlim() == pytest.approx((-4.15, 6.1)) and axes.get_ylim() == pytest.approx((-4.15, 4.15))


def test_a_floor_without_end_changes_nothing_else(furnished, with_plane):
    axes, _ = drawn(furnished)
    wide, walls = drawn(with_plane)
    assert (wide.get_xlim(), wide.get_ylim()) == (axes.get_xlim(), axes.get_ylim())
    assert not filled(walls["plane"]) and not walls["plane"].get_hatch()
    for name in HATCHED:
        assert walls[name].get_hatch()


def test_the_shipped_map_is_all_solid(scene):
    axes, walls = drawn(scene)
    assert all(filled(wall) and not wall.get_hatch() for wall in walls.values())
    corners = np.array([axes.get_xlim(), axes.get_ylim()]).T
    np.testing.assert_allclose(corners, [scene.wall_lower.min(0)[:2], scene.wall_upper.max(0)[:2]])


def test_starts_goals_and_ways_can_be_told_apart(furnished):
    figure = rooms(furnished, TABLE)
    (axes,) = figure.axes
    rings = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert sorted(ring.center for ring in rings) == [(-2, -2), (4, 3)]
    assert {ring.radius for ring in rings} == {0.5} and not any(map(filled, rings))  # metres
    dots = [line.get_xydata()[0].tolist() for line in axes.lines if line.get_marker() == "o"]
    assert sorted(dots) == [[-2, 0], [4.5, 0]]
    ways = [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]
    assert [way._posA_posB for way in ways] == [
        [pytest.approx(a), pytest.approx(b)] for a, b in zip(TABLE.start, TABLE.goal, strict=True)
    ]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "Start",
        "Goal, reached within 0.5 m",
        "From start to goal",
        "Wall",
        "Wall below or above flights",
    ]


@pytest.mark.parametrize(
    "endings", [("goal", "goal"), ("goal", "collision"), ("timeout", "collision"), ("other", "goal")]
)
def test_the_legend_names_what_flights_there_are_and_fits(endings, furnished):
    flights = pd.DataFrame(
        {
            "episode": [0, 0, 1, 1],
            "config": [0, 0, 1, 1],
            "ending": np.repeat(endings, 2),
            "x": [0.0, 1, 2, 3],
            "y": [0.0, 0, 1, 1],
        }
    )
    figure = rooms(furnished, TABLE, flights)
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    for kind, about in LOOKS.items():
        assert (about.label in words) == (kind in endings)
        assert (about.words in figure.axes[0].get_title("left")) == (kind in endings)
    figure.draw_without_rendering()
    extent = figure.legends[0].get_window_extent()
    assert figure.bbox.x0 <= extent.x0 and extent.x1 <= figure.bbox.x1
    assert not extent.overlaps(figure.axes[0].get_window_extent())


def test_endings_differ_in_colour_and_mark():
    failed = [about for kind, about in LOOKS.items() if kind != "goal"]
    assert len({about.mark for about in failed}) == len(failed)
    assert len({LOOKS[kind].color for kind in ("goal", "collision", "timeout")}) == 3


def test_each_flight_has_an_arrow_along_it(furnished):
    x = np.linspace(-2, 2, 9)
    flights = pd.DataFrame({"episode": 0, "config": 0, "ending": "goal", "x": x, "y": 0.0})
    (axes,) = rooms(furnished, TABLE, flights).axes
    (arrow,) = [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]
    (x_from, y_from), (x_to, y_to) = arrow._posA_posB
    assert -2 < x_from < x_to < 2 and y_from == y_to == 0


def test_how_flights_ended_is_read_from_the_run(monkeypatch):
    table = pd.DataFrame({"episode": [3, 3, 5, 7, 9], "success": [1, 1, 0, 0, 0]})
    places = {"success": [3], "collision": [5], "timeout": [7]}
    kinds = {name: np.isin(np.arange(10), at) for name, at in places.items()}

    class Run:
        def __init__(self, kept):
            self.kept = kept

        def iterations(self, name):
            return self.kept

        def arrays(self, name, iteration):
            return kinds

    monkeypatch.setattr(flight_figures, "trajectory_table", lambda run: table)
    found = flight_figures.flights_of(Run([5, 60])).ending.tolist()
    assert found == ["goal", "goal", "collision", "timeout", "other"]
    former = flight_figures.flights_of(Run([])).ending.tolist()  # version 0.1 kept no arrays
    assert former == ["goal", "goal", "other", "other", "other"]


def arrows(scene, ratios):
    axes = Figure().subplots()
    shade = success(axes, scene, pecjax.COORDINATE_SET_1, ratios, pecjax.NavigationSettings(), 0.5)
    return shade, [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]


def test_ways_of_a_study_keep_their_colours(scene):
    ratios = np.linspace(0.5, 1, 20)
    shade, ways = arrows(scene, ratios)
    assert [way.get_edgecolor() for way in ways] == [to_rgba(shade.to_rgba(ratio)) for ratio in ratios[::-1]]
    widths = [way.get_linewidth() for way in ways]
    assert widths == sorted(widths), "the lower, the broader"


def test_ways_of_a_study_go_around_walls(scene):
    """c12 and c13 lead through a door that is not between them: no point of their arrows is in a wall."""
    _, ways = arrows(scene, np.ones(20))
    around = [way for way in ways if way._posA_posB is None]
    assert 0 < len(around) < 20
    points = np.concatenate([way._path_original.vertices for way in around])
    for lower, upper in zip(scene.wall_lower, scene.wall_upper, strict=True):
        if lower[2] < 1.2 < upper[2]:
            assert not ((points > lower[:2]) & (points < upper[:2])).all(axis=1).any()
