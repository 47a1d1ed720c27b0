"""Comparisons: how many steps samplers need, in pairs, with p values for many of them (docs/benchmark.md)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from pecjax.studies.statistics import Interval, sign_flip_p

CONFIDENCE = 0.95


class Comparison(NamedTuple):
    """By how much one is above another.

    Attributes:
        value, low, high: the mean over pairs with its 95 % interval, by Student's t.
        p: how often pairs would differ by chance as much, or more, either way (`sign_flip_p`).
        pairs: how many there are.
    """

    value: float
    low: float
    high: float
    p: float
    pairs: int


def steps_to(steps: np.ndarray, ratios: np.ndarray, threshold: float, budget: float) -> float:
    """Steps at which a curve reaches a threshold, the whole budget where it never does.

    It is reached where two evaluations in a row, or the last one, are at the threshold or above; the place is
    interpolated between the first of them and the one before. Nothing is known of a curve before its first
    evaluation.

    Args:
        steps, ratios: (V,), of every evaluation; a NaN is below any threshold.
        budget: of the training; what was not reached took as long at least.
    """
    above = ratios >= threshold
    held = above & np.append(above[1:], True)
    if not held.any():
        return float(budget)
    first = int(np.argmax(held))
    if first == 0 or not np.isfinite(ratios[first - 1]):
        return float(steps[first])
    before = ratios[first - 1]  # below the threshold, or this would be the first
    part = (threshold - before) / (ratios[first] - before)
    return float(steps[first - 1] + part * (steps[first] - steps[first - 1]))


def relative(ours: np.ndarray, theirs: np.ndarray) -> Comparison:
    """Ours over theirs, less one: (P,) positive numbers of each, such as steps; -0.2 is a fifth less.

    The mean is the geometric one.
    """
    found = difference(np.log(np.asarray(ours, float)), np.log(np.asarray(theirs, float)))
    value, low, high = (float(np.expm1(log)) for log in found[:3])
    return Comparison(value, low, high, found.p, found.pairs)


def difference(ours: np.ndarray, theirs: np.ndarray) -> Comparison:
    """Ours less theirs, pair by pair: (P,) numbers of each."""
    differences = np.asarray(ours, float) - np.asarray(theirs, float)
    mean, pairs = float(differences.mean()), len(differences)
    low = high = float("nan")
    if pairs > 1:
        error = float(stats.sem(differences))
        low, high = stats.t.interval(CONFIDENCE, pairs - 1, mean, error) if error else (mean, mean)
    return Comparison(mean, float(low), float(high), sign_flip_p(differences), pairs)


def mean_relative(groups: Sequence[tuple[np.ndarray, np.ndarray]]) -> Interval:
    """What `relative` gives, as the geometric mean over groups of pairs, each of which weighs the same.

    The 95 % interval is by Student's t, with degrees of freedom for unequal variances (Satterthwaite 1946).

    Args:
        groups: ours and theirs, (P,) positive numbers of each, two at least.
    """
    logs = [np.log(np.asarray(ours, float) / np.asarray(theirs, float)) for ours, theirs in groups]
    mean = float(np.mean([of.mean() for of in logs]))
    variances = np.array([of.var(ddof=1) / len(of) for of in logs])
    if not variances.any():
        return Interval(*[float(np.expm1(mean))] * 3)
    freedom = variances.sum() ** 2 / (variances**2 / [len(of) - 1 for of in logs]).sum()
    low, high = stats.t.interval(CONFIDENCE, freedom, mean, np.sqrt(variances.sum()) / len(logs))
    return Interval(*(float(np.expm1(log)) for log in (mean, low, high)))


def holm(p_values: np.ndarray) -> np.ndarray:
    """Corrected p values (C,) of several comparisons: one below 0.05 among them is rare (Holm 1979)."""
    order = np.argsort(p_values, kind="stable")
    factors = np.arange(len(p_values), 0, -1)
    corrected = np.empty(len(p_values))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(factors * np.asarray(p_values)[order]))
    return corrected
