"""What an evaluation comes to, against formulas written out and what they are known to give."""

import json

import numpy as np
import pytest
from scipy import stats

from pecjax.envs.task import EvalSet
from pecjax.plotting.evaluation import evaluation
from pecjax.storage.tables import csv_text, joined_tables
from pecjax.training.eval_report import BINS, make_report
from pecjax.training.measures import cvar, figures_of, spl, unbiased_cvar
from pecjax.training.rows import evaluation_row
from pecjax.training.run_episodes import EvalResult


def flights(config_id, success, path_length=None):
    number = len(config_id)
    metrics = {} if path_length is None else {"path_length": np.asarray(path_length, float)}
    return EvalResult(
        np.asarray(config_id), np.asarray(success, bool), np.zeros(number), np.full(number, 10), metrics
    )


def test_success_weighted_by_path_length_is_the_sum_of_its_definition():
    result = flights([0, 0, 1, 1], [True, False, True, True], [10, 1, 3, 4])
    about = EvalSet(np.zeros(2), shortest=np.array([5.0, 4.0]))
    assert spl(result, about) == pytest.approx((5 / 10 + 0 + 1 + 1) / 4)  # 3 m is shorter than can be
    assert spl(result, EvalSet(np.zeros(2))) is None
    assert spl(flights([0], [True]), about) is None


def test_cvar_of_equal_configurations_is_biased_and_the_other_is_not():
    """All succeed at 0.7: the lowest tenth of noisy ratios is far below, on other episodes it is not."""
    draw, found = np.random.default_rng(0), []
    config_id = np.repeat(np.arange(100), 10)
    for _ in range(60):
        result = flights(config_id, draw.random(1000) < 0.7)
        found.append(
            (
                unbiased_cvar(result.config_id, result.success, 100),
                cvar(result.success.reshape(100, 10).mean(axis=1)),
            )
        )
    unbiased, biased = np.mean(found, axis=0)
    assert abs(unbiased - 0.7) < 3 * np.std(found, axis=0)[0] / np.sqrt(60) + 1e-3
    assert biased < 0.5


def test_cvar_finds_those_that_always_fail():
    config_id = np.repeat(np.arange(20), 4)
    assert unbiased_cvar(config_id, config_id >= 2, 20) == 0
    assert unbiased_cvar(np.arange(20), np.ones(20), 20) is None, "one episode each"


def test_the_interval_is_wilsons():
    found = figures_of(flights(np.zeros(50, int), np.arange(50) < 45), EvalSet(np.zeros(1)), 1)
    low, high = found["interval"]
    z, p, n = stats.norm.ppf(0.975), 0.9, 50
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    np.testing.assert_allclose([low, high], np.array([middle - half, middle + half]) / (1 + z * z / n))
    assert found["goal_ratio"] == 0.9 and found["steps_to_goal"] == 10


@pytest.fixture
def report():
    draw = np.random.default_rng(1)
    config_id = np.repeat(np.arange(40), 3)
    about = EvalSet(np.zeros(40), ("low", "high", "none"), (np.arange(40) >= 20).astype(int))
    wind = np.arange(40) / 4
    success = draw.random(120) < np.where(wind[config_id] < 5, 0.9, 0.3)
    return make_report(flights(config_id, success), about, {"wind (m/s)": wind, "gust": np.arange(40) % 2})


def test_groups_and_bins_are_parts_of_the_whole(report):
    assert [part["episodes"] for part in report["groups"].values()] == [60, 60, 0]
    bins = report["features"]["wind (m/s)"]
    assert len(bins) == BINS and sum(part["episodes"] for part in bins) == 120
    assert [part["low"] for part in bins][1:] > [part["high"] for part in bins][:-1]
    assert [(part["low"], part["high"]) for part in report["features"]["gust"]] == [(0, 0), (1, 1)]
    whole = sum(part["goal_ratio"] * part["episodes"] for part in bins) / 120
    assert whole == pytest.approx(report["all"]["goal_ratio"])
    json.dumps(report)


def test_five_values_as_many_times_each_are_five_bins():
    config_id, values = np.arange(50), np.tile([0.0, 2, 4, 6, 8], 10)
    found = make_report(flights(config_id, config_id < 25), EvalSet(np.zeros(50)), {"wind": values})
    bins = found["features"]["wind"]
    assert [(part["low"], part["high"], part["episodes"]) for part in bins] == [
        (v, v, 10) for v in (0, 2, 4, 6, 8)
    ]


def test_the_figure_has_a_panel_for_each(report):
    figure = evaluation(report)
    assert [axes.get_xlabel() for axes in figure.axes] == ["Groups", "Wind (m/s)", "Gust"]
    (shown,) = figure.axes[0].containers
    heights = [part["goal_ratio"] for part in report["groups"].values() if part["episodes"]]
    np.testing.assert_allclose(shown.lines[0].get_ydata(), heights)


def test_a_row_has_groups_and_spl_where_they_are_known():
    about = EvalSet(np.zeros(2), ("easy", "hard"), np.array([0, 1]), np.array([5.0, 4.0]))
    row = evaluation_row(1, 10, flights([0, 0, 1, 1], [1, 1, 0, 1], [10, 5, 3, 4]), about)
    assert row["goal_ratio.easy"] == 1 and row["goal_ratio.hard"] == 0.5 and row["spl"] == 0.625
    plain = evaluation_row(1, 10, flights([0, 1], [1, 1], [10, 5]), EvalSet(np.zeros(2)))
    assert "spl" not in plain and not [name for name in plain if name.startswith("goal_ratio.")]
    assert np.isnan(evaluation_row(1, 10, flights([0], [1], [9]), about)["goal_ratio.hard"])


def test_tables_of_other_columns_are_joined_by_name():
    one, two = csv_text([{"a": 1, "b": 2}]), csv_text([{"a": 3, "c": 4, "b": 5}])
    assert joined_tables([one, two, ""]) == "a,c,b\n1,,2\n3,4,5\n"
    assert joined_tables([one, one]) == "a,b\n1,2\n1,2\n"
    assert joined_tables(["", ""]) == "\n"
