"""Tables: the rows of a run's CSV files."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pecjax.agents.agent import Metrics
from pecjax.storage.files import Row
from pecjax.training.evaluation import EvalResult, goal_ratios

DRAWN_FLIGHTS = 2  # of each configuration, kept in trajectories.csv


def metrics_row(iteration: int, batch: int, seconds: float, metrics: Metrics) -> Row:
    """One row of metrics.csv, for an iteration of `batch` environment steps."""
    trials = int(np.asarray(metrics.counts)[0].sum())
    reported, failures = np.asarray(metrics.reported).tolist()

    def mean(total: float) -> float:
        return total / trials if trials else float("nan")

    return {
        "iteration": iteration,
        "env_steps": iteration * batch,
        "seconds": round(seconds, 3),
        "goal_ratio": (reported - failures) / reported if reported else float("nan"),
        "episodes": trials,
        "mean_return": mean(float(metrics.return_sum)),
        "mean_length": mean(float(metrics.length_sum)),
        "unstable": int(metrics.unstable),
    } | {name: float(value) for name, value in metrics.losses.items()}


def configuration_rows(iteration: int, counts: np.ndarray, probabilities: np.ndarray) -> Iterator[Row]:
    """The rows of configurations.csv for one iteration, from the counts (2, N) so far."""
    for config, (trials, failures) in enumerate(counts.T):
        yield {
            "iteration": iteration,
            "config": config,
            "trials": trials,
            "failures": failures,
            "probability": probabilities[config],
        }


def evaluation_row(iteration: int, env_steps: int, flights: EvalResult, num_configs: int) -> Row:
    """One row of evaluation.csv; column c3 is the goal ratio of configuration 3."""
    ratios = goal_ratios(flights, num_configs)
    return {
        "iteration": iteration,
        "env_steps": env_steps,
        "goal_ratio": float(flights.goal.mean()),
        "mean_return": float(flights.returns.mean()),
    } | {f"c{config}": ratio for config, ratio in enumerate(ratios)}


def path_rows(flights: EvalResult, num_configs: int) -> Iterator[Row]:
    """The rows of trajectories.csv: some flights of each configuration, step by step."""
    for config in range(num_configs):
        for episode in np.flatnonzero(flights.config_id == config)[:DRAWN_FLIGHTS]:
            path = flights.paths[episode, : flights.lengths[episode] + 1]
            for step, (x, y) in enumerate(path):
                goal = int(flights.goal[episode])
                yield {"episode": episode, "config": config, "goal": goal, "step": step, "x": x, "y": y}
