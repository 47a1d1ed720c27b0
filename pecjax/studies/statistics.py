"""Measures: what runs are compared by, with intervals over seeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from pecjax.training.measures import cvar as cvar

PATIENCE = 5  # evaluations, or iterations, in a row that count as held
RESAMPLES = 2000


class Interval(NamedTuple):
    """A figure with its 95 % interval."""

    value: float
    low: float
    high: float


def first_sustained(ratios: np.ndarray, threshold: float) -> int | None:
    """The place at which the first `PATIENCE` figures in a row at the threshold or above begin."""
    reached = ratios >= threshold
    for first in range(len(reached) - PATIENCE + 1):
        if reached[first : first + PATIENCE].all():
            return first
    return None


def steps_to_threshold(steps: np.ndarray, ratios: np.ndarray, threshold: float) -> float:
    """Environment steps at the first of `PATIENCE` figures in a row that hold it; inf if none do."""
    first = first_sustained(ratios, threshold)
    return float("inf") if first is None else float(steps[first])


def steps_to_exit(steps: np.ndarray, ratios: np.ndarray, threshold: float) -> float:
    """Environment steps at the last of them, where the paper's exit condition ends a training."""
    first = first_sustained(ratios, threshold)
    return float("inf") if first is None else float(steps[first + PATIENCE - 1])


def area_under_curve(steps: np.ndarray, ratios: np.ndarray) -> float:
    """The mean of the curve from the first to the last of its steps, by the trapezoidal rule."""
    if len(steps) == 1:
        return float(ratios[0])
    return float(np.trapezoid(ratios, steps) / (steps[-1] - steps[0]))


def interquartile_mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """The mean of the middle half (Agarwal et al. 2021, "Deep RL at the edge of the precipice")."""
    return stats.trim_mean(values, 0.25, axis=axis)


def interval(values: np.ndarray, statistic: Callable[..., np.ndarray] = interquartile_mean) -> Interval:
    """A statistic over seeds with its bootstrap 95 % interval (percentiles); NaN below two seeds."""
    sample = values.astype(float)
    value = float(statistic(sample, axis=-1))
    if len(sample) < 2 or not np.isfinite(sample).all():
        return Interval(value, float("nan"), float("nan"))
    if np.all(sample == sample[0]):
        return Interval(value, value, value)
    found = stats.bootstrap(
        (sample,), statistic, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return Interval(value, float(found.low), float(found.high))


def sign_flip_p(differences: np.ndarray) -> float:
    """How often pairs would differ by chance as much in the mean, or more, either way.

    By exchanging the two of each pair: every pattern of signs up to 13 pairs, else 9,999 drawn ones
    (`scipy.stats.permutation_test`). Of n pairs it is 2 / 2ⁿ at least.
    """
    if len(differences) < 2:
        return 1.0
    found = stats.permutation_test(
        (differences.astype(float),), np.mean, permutation_type="samples", rng=np.random.default_rng(0)
    )
    return float(found.pvalue)


def trial_and_failure_ratios(counts: pd.DataFrame, within: list[str]) -> pd.DataFrame:
    """Counts with a column `trial`, the share of the trials, and `failure`, of those that failed.

    Args:
        counts: columns trials and failures, a row a configuration.
        within: columns whose every combination has all the configurations once.

    Returns:
        the same rows; `failure` is NaN where nothing was tried.
    """
    tried = counts.trials.where(counts.trials > 0)
    total = counts.groupby(within, sort=False).trials.transform("sum").clip(lower=1)
    return counts.assign(trial=counts.trials / total, failure=counts.failures / tried)


def effective_number(shares: np.ndarray) -> float:
    """The exponential of the entropy of shares (N,): N where all are alike, 1 where one has everything."""
    return float(np.exp(stats.entropy(shares)))


def paired_difference(values: np.ndarray, baseline: np.ndarray) -> Interval:
    """Mean of values - baseline, pair by pair, with its bootstrap 95 % interval."""
    return interval(values - baseline, np.mean)
