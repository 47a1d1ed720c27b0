"""Figures of a run, by what is drawn: every line named, every mark whole, ticks at what exists."""

import numpy as np
import pandas as pd
import pytest

from pecjax.plotting import run as run_figures
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
