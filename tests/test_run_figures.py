"""Figures of a run, by what is drawn: every line named, every mark whole, ticks at what exists."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch

from pecjax.envs.rooms.scene import default_scene_path
from pecjax.envs.rooms.settings import Rooms
from pecjax.plotting import maps, run as run_figures
from pecjax.plotting.configurations import configurations


def made_metrics(iterations, batch=16_384):
    iteration = np.arange(1, iterations + 1)
    ratio = np.linspace(0, 1, iterations)
    return pd.DataFrame({"iteration": iteration, "env_steps": iteration * batch, "goal_ratio": ratio})


def made_evaluation(iterations):
    return pd.DataFrame(
        {"iteration": [1, iterations], "goal_ratio": [0.0, 1.0], "mean_return": [-900.0, 1900]}
    )


def made_counts(size, iterations):
    return pd.DataFrame(
        [
            {"iteration": iteration, "config": config, "trials": 10 + config, "failures": config % 3}
            for iteration in iterations
            for config in range(size)
        ]
    )


def shown_ticks(axes):
    axes.figure.draw_without_rendering()
    low, high = axes.get_xlim()
    return [tick for tick in axes.get_xticks() if low <= tick <= high]


@pytest.mark.parametrize("iterations", [2, 4, 457])
def test_goal_ratio_names_its_lines_and_cuts_no_mark(iterations):
    axes = run_figures.goal_ratio(made_metrics(iterations), made_evaluation(iterations), True).axes[0]
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert len(words) == len(axes.lines) == 3 and "training, each iteration" in words
    marks = next(line for line in axes.lines if line.get_marker() == "o").get_xydata()
    pixels, box = axes.transData.transform(marks), axes.bbox
    assert (pixels > [box.x0, box.y0]).all() and (pixels < [box.x1, box.y1]).all()
    assert all(tick == round(tick) for tick in shown_ticks(axes))


@pytest.mark.parametrize("iterations", [1, 3])
def test_iterations_are_whole_numbers(iterations):
    figures = [
        run_figures.spread(made_counts(4, range(1, iterations + 1))),
        run_figures.evaluations(made_evaluation(iterations), 20, True),
    ]
    for axes in (axes for figure in figures for axes in figure.axes):
        assert all(tick == round(tick) for tick in shown_ticks(axes))
        assert axes.get_xlabel() == "iteration"


@pytest.mark.parametrize("size", [1, 2, 3, 20, 24])
def test_ticks_stand_at_configurations_that_exist(size):
    figure = configurations(made_counts(size, [1, 2]))
    for axes in figure.axes:
        ticks = shown_ticks(axes)
        assert ticks and set(ticks) <= set(range(size))
        marks = [line for line in axes.lines if line.get_marker() == "o"]
        assert all(not line.get_clip_on() for line in marks)


@pytest.fixture(scope="module")
def two_maps(tmp_path_factory):
    """The six rooms twice; configurations 1, 3 and 4 are in the first."""
    path = tmp_path_factory.mktemp("maps") / "pairs.csv"
    path.write_text(
        "start_x start_y goal_x goal_y map\n0 0 1 0 1\n0 -2 0.7 -2 0\n0 -2 0.7 -2 1\n0 0 2 0 0\n0 -2 2 -2 0\n"
    )
    return Rooms(table=str(path), maps=(str(default_scene_path()),) * 2)


def names_on(axes):
    return {text.get_text() for text in axes.texts}


def test_of_several_maps_the_first_is_drawn_with_what_is_in_it(two_maps):
    flights = pd.DataFrame(
        [
            {"episode": 10 + config, "config": config, "success": config % 2, "step": step, "x": x, "y": 0.5}
            for config in range(5)
            for step, x in enumerate((config, config + 0.25))
        ]
    )
    (axes,) = run_figures._one_map(two_maps, flights).axes
    assert names_on(axes) == {"c1,c4", "c3"}  # by their own numbers
    drawn = [line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 2]
    assert drawn == [1, 3, 4] and axes.get_title().startswith("2 of 3 flights")
    goals = {patch.center for patch in axes.patches if isinstance(patch, Circle)}
    assert goals == {(np.float32(0.7).item(), -2), (2, 0), (2, -2)}


def test_goal_ratios_of_several_maps_keep_to_their_configurations(two_maps):
    axes = Figure().subplots()
    ratios = np.array([0.1, 0.9, 0.2, 0.6, 0.7])
    shade = maps.success(axes, two_maps.scenes()[0], two_maps.configurations(), ratios, two_maps)
    arrows = [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]
    colors = [arrow.get_facecolor() for arrow in arrows]
    np.testing.assert_allclose(colors, shade.to_rgba(ratios[[1, 3, 4]]))
    assert names_on(axes) == {"c1,c4", "c3"}
