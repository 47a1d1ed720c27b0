"""Several seeds in one figure: what stands for them, and the words that say so."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from pecjax.studies.statistics import Interval, interquartile_mean, interval

ENOUGH = 5  # seeds, for an interval: below, the bootstrap gives little else than the range


def by_condition(table: pd.DataFrame) -> Iterator[tuple[Any, pd.DataFrame]]:
    """The rows of each condition, in the order in which they were named."""
    yield from table.groupby("condition", sort=False)


def num_seeds(table: pd.DataFrame) -> tuple[int, int]:
    """The least and the greatest number of seeds of its conditions."""
    number = table.groupby("condition").seed.nunique()
    return int(number.min()), int(number.max())


def band_of(table: pd.DataFrame, values: np.ndarray) -> Interval:
    """The interquartile mean of seeds (S,) with its interval, or with their range where they are few.

    Args:
        table: that is drawn; all its conditions get the same.
    """
    if num_seeds(table)[0] >= ENOUGH:
        return interval(values)
    return Interval(float(interquartile_mean(values)), float(values.min()), float(values.max()))


def seeds_in_words(table: pd.DataFrame) -> str:
    """How many seeds its conditions have."""
    least, most = num_seeds(table)
    return f"n = {most} seed{'s' * (most > 1)}" if least == most else f"n = {least} to {most} seeds"


def how_it_spreads(table: pd.DataFrame) -> str:
    """What `band_of` gives, in words."""
    (least, most), seeds = num_seeds(table), seeds_in_words(table)
    if most == 1:
        return "One seed each"
    if least >= ENOUGH:
        return f"Interquartile mean and 95 % bootstrap interval, {seeds}"
    return f"Interquartile mean and range, {seeds}"
