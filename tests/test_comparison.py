"""Comparisons of samplers against plain loops, simulation and the definition of Holm's method."""

import itertools

import numpy as np
import pytest
from scipy import stats

from pecjax.studies.comparison import holm, mean_relative, relative, steps_to

STEPS = np.arange(1, 9) * 100.0


@pytest.mark.parametrize(
    ("ratios", "expected"),
    [
        ([0.1, 0.3, 0.5, 0.7, 0.9, 0.9, 0.9, 0.9], 350.0),
        ([0.1, 0.3, 0.6, 0.7, 0.7, 0.8, 0.9, 0.9], 300.0),  # exactly there
        ([0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9], 100.0),  # at its first evaluation
        ([0.1, 0.7, 0.1, 0.1, 0.5, 0.7, 0.7, 0.1], 550.0),  # one alone does not count
        ([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.5, 0.7], 750.0),  # but the last does
        ([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1], 1000.0),
        ([np.nan, 0.7, 0.7, 0.1, 0.1, 0.1, 0.1, 0.1], 200.0),
        ([np.nan] * 8, 1000.0),
    ],
)
def test_steps_to_a_threshold(ratios, expected):
    assert steps_to(STEPS, np.array(ratios), 0.6, 1000.0) == pytest.approx(expected)


def test_steps_rise_with_the_threshold_and_stay_within_the_budget():
    draw = np.random.default_rng(0)
    for _ in range(200):
        ratios = np.clip(np.cumsum(draw.normal(0.1, 0.2, 8)), 0, 1)
        found = [steps_to(STEPS, ratios, threshold, 1000.0) for threshold in np.linspace(0.05, 1, 20)]
        assert np.all(np.diff(found) >= -1e-9) and found[0] >= 100 and found[-1] <= 1000


def test_relative_is_a_geometric_mean_whose_interval_holds_the_truth_as_often_as_it_says():
    found = relative(np.array([80.0, 40.0]), np.array([100.0, 50.0]))
    np.testing.assert_allclose(found[:3], -0.2, rtol=1e-9)
    assert found.pairs == 2
    draw, held = np.random.default_rng(1), []
    for _ in range(2000):
        theirs = np.exp(draw.normal(0, 0.3, 10))
        ours = 0.8 * theirs * np.exp(draw.normal(0, 0.3, 10))
        low, high = relative(ours, theirs)[1:3]
        held.append(low <= -0.2 <= high)
    assert 0.935 < np.mean(held) < 0.965
    one = relative(np.array([80.0]), np.array([100.0]))
    assert one.value == pytest.approx(-0.2) and np.isnan([one.low, one.high]).all() and one.p == 1


def test_the_mean_over_groups_is_that_of_scipy():
    """Of two groups it is half of what Welch's test has of the first and the second with its sign changed."""
    draw = np.random.default_rng(3)
    one, two = draw.normal(-0.2, 0.1, 10), draw.normal(0.1, 0.4, 5)
    found = mean_relative([(np.exp(one), np.ones(10)), (3 * np.exp(two), np.full(5, 3.0))])
    welch = stats.ttest_ind(one, -two, equal_var=False).confidence_interval()
    expected = [(one.mean() + two.mean()) / 2, welch.low / 2, welch.high / 2]
    np.testing.assert_allclose(found, np.expm1(expected), rtol=1e-9)
    same = mean_relative([(np.ones(3), np.ones(3)), (np.full(2, 4.0), np.ones(2))])
    np.testing.assert_allclose(same, [1.0] * 3, rtol=1e-12)  # without any spread
    alone = mean_relative([(np.exp(one), np.ones(10))])
    np.testing.assert_allclose(alone, relative(np.exp(one), np.ones(10))[:3], rtol=1e-9)


def test_the_p_value_counts_all_exchanges():
    draw = np.random.default_rng(2)
    ours, theirs = np.exp(draw.normal(0.3, 0.3, (2, 6)))
    logs = np.log(ours / theirs)
    means = [np.mean(logs * signs) for signs in itertools.product((-1, 1), repeat=6)]
    expected = np.mean(np.abs(means) >= abs(logs.mean()) - 1e-12)
    assert relative(ours, theirs).p == pytest.approx(expected)


def test_holm_rejects_what_its_definition_does():
    draw = np.random.default_rng(3)
    for _ in range(200):
        p_values = draw.random(7) ** 3
        rejected, level = set(), 0.05
        for rank, place in enumerate(np.argsort(p_values)):
            if p_values[place] > level / (7 - rank):
                break
            rejected.add(int(place))
        assert set(np.flatnonzero(holm(p_values) <= level).tolist()) == rejected
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03])), [0.03, 0.06, 0.06])


def test_holm_keeps_the_rate_of_false_alarms():
    """Of families in which nothing differs, about one in twenty has any p below 0.05."""
    draw = np.random.default_rng(4)
    alarms = [holm(stats.norm.sf(np.abs(draw.normal(size=8))) * 2).min() <= 0.05 for _ in range(4000)]
    assert 0.04 < np.mean(alarms) < 0.06
