"""History: how often a training drew its configurations, iteration by iteration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pecjax.envs.rooms.config import Configurations
from pecjax.training.run_arrays import run_arrays
from pecjax.training.run_directory import RunDirectory

MOST_SHOWN = 150  # configurations
MOST_ITERATIONS = 100


class History(NamedTuple):
    """Probabilities of M of the N configurations that were trained in.

    Attributes:
        iterations: (I,) int, those whose probabilities are known.
        relative: (I, M) probability over 1/N.
        starts, goals: (M, 2) m.
        map_id: (M,) int.
        num_configs: N.
    """

    iterations: np.ndarray
    relative: np.ndarray
    starts: np.ndarray
    goals: np.ndarray
    map_id: np.ndarray
    num_configs: int


def read_history(run: RunDirectory, table: Configurations) -> History:
    """The history of a training; of many configurations or iterations some, spread evenly.

    Args:
        table: the configurations that were trained in.

    Raises:
        InputError: the run's arrays cannot be read, or are not of this table.
    """
    iterations = _some(run.iterations("configurations"), MOST_ITERATIONS)
    configs = np.array(_some(range(table.size), MOST_SHOWN))
    relative = np.zeros((len(iterations), len(configs)))
    for place, iteration in enumerate(iterations):
        with run_arrays(run, "configurations", iteration) as arrays:
            probability = arrays["probability"]
            if probability.shape != (table.size,):
                raise ValueError(f"{probability.shape} probabilities of {table.size} configurations")
            relative[place] = probability[configs] * table.size
    return History(
        np.array(iterations),
        relative,
        *(np.asarray(leaf)[configs] for leaf in (table.start, table.goal, table.map_id)),
        num_configs=table.size,
    )


def _some(values: Sequence[int], most: int) -> list[int]:
    places = np.linspace(0, len(values) - 1, min(len(values), most)).astype(int)
    return [values[place] for place in places]
