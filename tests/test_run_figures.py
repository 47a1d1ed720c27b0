"""Figures of a run, by what is drawn: every line named, every mark whole, ticks at what exists."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch
from scipy import stats

from pecjax.envs.rooms.scene import default_scene_path
from pecjax.envs.rooms.settings import Rooms
from pecjax.plotting import run as run_figures
from pecjax.plotting.configurations import configurations, snapshots
from pecjax.plotting.success_map import success


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
    figure = run_figures.goal_ratio(made_metrics(iterations), made_evaluation(iterations), 200, True)
    (axes,) = figure.axes
    words = [text.get_text().replace("\n", " ") for text in figure.legends[0].get_texts()]
    assert words == [
        "Training, every iteration",
        f"Training, centred mean of {2 if iterations < 5 else 20} iterations",
        "Uniform evaluation, greedy actions, 95 % interval (Wilson), n = 200 episodes",
    ]
    figure.draw_without_rendering()
    marks = next(line for line in axes.lines if line.get_marker() == "o").get_xydata()
    pixels, box = axes.transData.transform(marks), axes.bbox
    assert (pixels > [box.x0, box.y0]).all() and (pixels < [box.x1, box.y1]).all()
    assert all(tick == round(tick) for tick in shown_ticks(axes))


def test_the_smoothed_training_does_not_lag_behind():
    """Of a straight rise the mean is the rise itself, but near its ends; a trailing one would lie below."""
    axes = run_figures.goal_ratio(made_metrics(200), made_evaluation(200), 200, True).axes[0]
    raw, smooth = (line.get_ydata() for line in axes.lines[:2])
    np.testing.assert_allclose(smooth[20:-20], raw[20:-20], atol=0.51 / 199)


def test_bars_of_an_evaluation_are_wilsons():
    axes = run_figures.goal_ratio(made_metrics(9), made_evaluation(9), 40, False).axes[0]
    segments = [c.get_segments() for c in axes.collections if isinstance(c, LineCollection)]
    drawn = [segment[:, 1] for segment in segments[0]]
    for (low, high), successes in zip(drawn, (0, 40), strict=True):
        expected = stats.binomtest(successes, 40).proportion_ci(0.95, "wilson")
        np.testing.assert_allclose([low, high], [expected.low, expected.high], atol=1e-9)


def test_the_band_of_the_return_is_students():
    returns = {at: np.random.default_rng(at).normal(100, 30, 50) for at in (1, 9)}
    figure = run_figures.evaluations(made_evaluation(9), returns, 50, True)
    (band,) = figure.axes[1].collections
    corners = band.get_paths()[0].vertices
    for at, values in returns.items():
        expected = stats.ttest_1samp(values, 0).confidence_interval(0.95)
        heights = corners[corners[:, 0] == at, 1]
        np.testing.assert_allclose([heights.min(), heights.max()], [expected.low, expected.high])
    without = run_figures.evaluations(made_evaluation(9), {}, 50, True)
    assert not without.axes[1].collections


def test_the_spread_of_draws_is_their_effective_number():
    counts = made_counts(8, [1, 2]).assign(trials=5, probability=np.tile([0.5, 0.5] + [0.0] * 6, 2))
    left = run_figures.spread(counts).axes[0]
    of_trials, of_sampler, alike = (line.get_ydata() for line in left.lines)
    np.testing.assert_allclose(of_trials, 8)
    np.testing.assert_allclose(of_sampler, 2)
    np.testing.assert_allclose(alike, 8)


@pytest.mark.parametrize("iterations", [1, 3])
def test_iterations_are_whole_numbers(iterations):
    figures = [
        run_figures.spread(made_counts(4, range(1, iterations + 1))),
        run_figures.evaluations(made_evaluation(iterations), {}, 20, True),
    ]
    for axes in (axes for figure in figures for axes in figure.axes):
        assert all(tick == round(tick) for tick in shown_ticks(axes))
        assert axes.get_xlabel() == "Training iteration"


@pytest.mark.parametrize("size", [1, 2, 3, 20, 24])
def test_ticks_stand_at_configurations_that_exist(size):
    figure = configurations(made_counts(size, [1, 2]))
    for axes in figure.axes:
        ticks = shown_ticks(axes)
        assert ticks and set(ticks) <= set(range(size))
        assert len(axes.containers[0]) == size  # bars: between categories there is nothing
        assert [line for line in axes.lines if len(set(line.get_ydata())) > 1] == []


@pytest.mark.parametrize("iterations", [[1], [1, 60], range(15, 301, 15), [1, *range(10, 61, 10)]])
def test_snapshots_are_evenly_apart_and_the_last_is_one(iterations):
    chosen = snapshots(list(iterations))
    assert set(chosen) <= set(iterations) and chosen[-1] == max(iterations)
    assert len(chosen) == min(4, len(iterations))
    apart = np.diff(chosen)
    assert len(apart) == 0 or apart.max() - apart.min() <= 1


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
            {
                "episode": 10 + config,
                "config": config,
                "ending": "goal" if config % 2 else "timeout",
                "x": x,
                "y": 0.5,
            }
            for config in range(5)
            for step, x in enumerate((config, config + 0.25))
        ]
    )
    (axes,) = run_figures._one_map(two_maps, flights).axes
    assert names_on(axes) == {"c4"}  # by its own number: the one that failed
    drawn = [line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 2]
    title = "Of 3 flights, 2 reach their goal, 1 run out of time"
    assert drawn == [1, 3, 4] and axes.get_title("left") == title
    goals = {patch.center for patch in axes.patches if isinstance(patch, Circle)}
    assert goals == {(np.float32(0.7).item(), -2), (2, 0), (2, -2)}


def test_goal_ratios_of_several_maps_keep_to_their_configurations(two_maps):
    axes = Figure().subplots()
    ratios = np.array([0.1, 0.9, 0.2, 0.6, 0.7])
    shade = success(axes, two_maps.scenes()[0], two_maps.configurations(), ratios, two_maps)
    arrows = [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]
    colors = [arrow.get_facecolor() for arrow in arrows]
    np.testing.assert_allclose(colors, shade.to_rgba(ratios[[1, 4, 3]]))  # the lowest on top
    assert names_on(axes) == {"1,4", "3"}
