"""Measures against SciPy, hand counts and the definitions in Agarwal et al. (2021)."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from pecjax.studies.statistics import (
    area_under_curve,
    cvar,
    first_sustained,
    interquartile_mean,
    interval,
    paired_difference,
    sign_flip_p,
    steps_to_exit,
    steps_to_threshold,
    trial_and_failure_ratios,
)


def test_cvar_is_the_mean_of_the_worst_tenth():
    ratios = np.random.default_rng(0).random((4, 20))
    np.testing.assert_allclose(cvar(ratios), np.partition(ratios, 1, axis=-1)[:, :2].mean(-1))
    assert cvar(np.array([0.3, 0.9, 0.5])) == 0.3  # one at least
    assert cvar(np.array([np.nan] + [0.8] * 19)) == pytest.approx(0.8)  # not flown, not counted


@pytest.mark.parametrize("flown", [0, 1, 4, 15, 20, 40, 200])
def test_the_worst_tenth_is_of_the_configurations_flown(flown):
    rng = np.random.default_rng(flown)
    ratios = np.full((3, 200), np.nan)
    for row in ratios:
        row[rng.permutation(200)[:flown]] = rng.random(flown)
    found = cvar(ratios)
    for row, value in zip(ratios, found, strict=True):
        kept = sorted(ratio for ratio in row if not np.isnan(ratio))
        wanted = np.mean(kept[: max(1, round(flown / 10))]) if kept else np.nan
        assert value == pytest.approx(wanted, nan_ok=True)
    ratios[0] = np.arange(200)  # each row counts its own
    np.testing.assert_allclose(cvar(ratios)[1:], found[1:])
    assert cvar(ratios)[0] == pytest.approx(9.5)


@pytest.mark.parametrize(
    ("ratios", "at"),
    [
        ([0.9] * 5, 0),
        ([0.9] * 4, None),
        ([0.95, 0.95, 0.5, 0.95, 0.95, 0.95, 0.95, 0.95, 0.1], 3),
        ([0.91, 0.92, np.nan, 0.93, 0.94, 0.95, 0.96, 0.97], 3),
        ([], None),
    ],
)
def test_held_five_in_a_row(ratios, at):
    ratios = np.array(ratios, float)
    assert first_sustained(ratios, 0.9) == at
    steps = 100 * (1 + np.arange(len(ratios)))
    assert steps_to_threshold(steps, ratios, 0.9) == (np.inf if at is None else steps[at])
    assert steps_to_exit(steps, ratios, 0.9) == (np.inf if at is None else steps[at + 4])


def test_area_under_a_curve():
    steps = np.array([10, 20, 40])
    assert area_under_curve(steps, np.array([0.0, 1.0, 1.0])) == pytest.approx((5 + 20) / 30)
    assert area_under_curve(steps[:1], np.array([0.7])) == 0.7


@pytest.mark.parametrize("number", [4, 5, 10, 11])
def test_the_interquartile_mean_drops_the_outer_quarters(number):
    values = np.random.default_rng(number).random(number)
    outer = number // 4
    assert interquartile_mean(values) == pytest.approx(np.sort(values)[outer : number - outer].mean())
    values[0] = 1e9
    assert interquartile_mean(values) < 1


def test_intervals_cover_as_often_as_they_say():
    """Means of 12 normal figures: a percentile bootstrap covers a little less than 95 %."""
    rng = np.random.default_rng(1)
    found = [interval(rng.normal(size=12), np.mean) for _ in range(200)]
    covered = np.mean([low <= 0 <= high for _, low, high in found])
    # 3 standard deviations of 200 draws below the 91 % that a percentile bootstrap of 12 covers.
    assert 0.85 < covered < 0.98
    for value, low, high in found:
        assert low <= value <= high


def test_intervals_are_scipys_and_the_same_each_time():
    values = np.random.default_rng(2).random(7)
    again = stats.bootstrap(
        (values,), np.mean, n_resamples=2000, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    assert interval(values, np.mean)[1:] == (again.low, again.high) == interval(values, np.mean)[1:]


def test_intervals_of_few_or_equal_or_missing_figures():
    assert interval(np.array([0.5]))[0] == 0.5 and np.isnan(interval(np.array([0.5]))[1:]).all()
    assert interval(np.full(5, 0.7)) == pytest.approx((0.7, 0.7, 0.7))
    assert np.isnan(interval(np.array([1.0, np.inf, 2.0, 3.0]))[1:]).all()


def test_paired_differences_are_taken_pair_by_pair():
    ours, theirs = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.5, 1.5, 2.5, 3.5])
    assert paired_difference(ours, theirs) == pytest.approx((0.5, 0.5, 0.5))
    value, low, high = paired_difference(ours, theirs[::-1])
    assert value == pytest.approx(0.5) and low < 0.5 < high


@pytest.mark.parametrize("differences", [[0.3, -0.1, 0.2, 0.25, 0.0], [1.0, 2.0, 3.0], [0.0, 0.0], [-0.4]])
def test_p_is_the_share_of_exchanged_pairs_that_differ_as_much(differences):
    signs = np.array(list(itertools.product((-1, 1), repeat=len(differences))))
    means = np.abs((signs * differences).mean(axis=1))
    as_much = means >= abs(np.mean(differences)) - 1e-12
    assert sign_flip_p(np.array(differences)) == pytest.approx(as_much.mean())


def test_p_of_many_pairs_is_near_that_of_a_t_test():
    differences = np.random.default_rng(3).normal(0.3, 1, 40)
    assert sign_flip_p(differences) == pytest.approx(stats.ttest_1samp(differences, 0).pvalue, abs=0.02)
    assert sign_flip_p(differences) == sign_flip_p(differences)


def test_trial_and_failure_ratios_are_of_their_own_run():
    counts = pd.DataFrame({"seed": [0, 0, 1, 1], "trials": [6, 2, 5, 0], "failures": [3, 2, 1, 0]})
    ratios = trial_and_failure_ratios(counts, ["seed"])
    assert ratios.trial.tolist() == [0.75, 0.25, 1.0, 0.0]
    assert ratios.failure.tolist()[:3] == [0.5, 1.0, 0.2] and np.isnan(ratios.failure[3])
    untried = trial_and_failure_ratios(counts.assign(trials=0, failures=0), ["seed"])
    assert (untried.trial == 0).all() and untried.failure.isna().all()
