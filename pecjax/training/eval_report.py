"""The report of an evaluation: all episodes, each group, and by features of the configurations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pecjax.curriculum import bins
from pecjax.envs.task import EvalSet, num_configs
from pecjax.training.measures import by_group, figures_of, only
from pecjax.training.run_episodes import EvalResult

BINS = 5  # of a feature, as many configurations in each
Report = dict[str, Any]


def make_report(result: EvalResult, about: EvalSet, features: Mapping[str, np.ndarray]) -> Report:
    """Figures (see `measures.figures_of`) of an evaluation and of its parts.

    Args:
        features: numbers (N,) of each configuration, by name.

    Returns:
        `all`; `groups` by name; `features`: for each a list of bins, with the `low` and `high` of the
        numbers in it.
    """
    number = num_configs(about.table)
    groups = {name: figures_of(only(result, of), about, number) for name, of in by_group(result, about)}
    by_feature = {}
    for name, values in features.items():
        of_episode = np.asarray(values)[result.config_id]
        by_feature[name] = [
            {"low": float(low), "high": float(high)} | figures_of(only(result, inside), about, number)
            for low, high, inside in _bins(of_episode)
        ]
    return {"all": figures_of(result, about, number), "groups": groups, "features": by_feature}


def _bins(values: np.ndarray) -> list[tuple[float, float, np.ndarray]]:
    """The lowest and highest number of each bin, and which (E,) are in it; equal numbers stay together."""
    place = bins([values], BINS)
    parts = [place == number for number in range(place.max() + 1)]
    return [(values[part].min(), values[part].max(), part) for part in parts]
