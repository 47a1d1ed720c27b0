"""Rows: the figures of an iteration or an evaluation, as tables have them."""

from __future__ import annotations

from typing import Any

import numpy as np

from pecjax.agents import Metrics
from pecjax.envs.task import EvalSet, num_configs
from pecjax.storage.tables import Row
from pecjax.training.measures import by_group, cvar, spl
from pecjax.training.run_episodes import EvalResult, in_order, success_by_config

RECORDED = 2  # episodes of each configuration whose poses and actions are kept
MOST_RECORDED = 100
RECORDING_ARRAYS = ("recorded", "poses", "actions")


def metrics_row(iteration: int, env_steps: int, metrics: Metrics) -> Row:
    """One row of metrics.csv; the task's metrics are means over the episodes that ended."""
    episodes = int(metrics.episodes)
    reported, failures = np.asarray(metrics.reported).tolist()
    ended = episodes or float("nan")
    means = {name: float(total) / ended for name, total in metrics.sums.items()}
    return {
        "iteration": iteration,
        "env_steps": env_steps,
        "goal_ratio": (reported - failures) / reported if reported else float("nan"),
        "episodes": episodes,
        "mean_return": means.pop("return"),
        "mean_length": means.pop("length"),
        **means,
        **{name: float(value) for name, value in (metrics.losses | metrics.sampler).items()},
    }


def evaluation_row(iteration: int, env_steps: int, result: EvalResult, about: EvalSet) -> Row:
    """One row of evaluation.csv; `cvar` is the CVaR-10 % over the configurations flown.

    Where shortest paths are known, `spl` is success weighted by path length; where there are groups,
    `goal_ratio.NAME` is that of one.
    """
    by_length = spl(result, about)
    return {
        "iteration": iteration,
        "env_steps": env_steps,
        "goal_ratio": float(result.success.mean()),
        "cvar": float(cvar(success_by_config(result.config_id, result.success, num_configs(about.table)))),
        **({} if by_length is None else {"spl": by_length}),
        "mean_return": float(result.returns.mean()),
        "mean_length": float(result.lengths.mean()),
        **{name: float(value.mean()) for name, value in sorted(result.metrics.items())},
        **{
            f"goal_ratio.{name}": float(result.success[of].mean()) if of.any() else float("nan")
            for name, of in by_group(result, about)
        },
    }


def configuration_arrays(counts: np.ndarray, probabilities: np.ndarray) -> dict[str, np.ndarray]:
    """What is kept of all configurations at an iteration, (N,) each.

    Args:
        counts: (3, N), trials, failures and steps since the beginning.
    """
    trials, failures, steps = counts
    return {"trials": trials, "failures": failures, "steps": steps, "probability": probabilities}


def episode_arrays(result: EvalResult) -> dict[str, Any]:
    """What is kept of an evaluation's episodes, (E,) each."""
    kept = {"config_id": result.config_id, "success": result.success, "return": result.returns}
    return kept | {"length": result.lengths, **result.metrics}


def recording_arrays(result: EvalResult, chosen: np.ndarray | None = None) -> dict[str, Any]:
    """`RECORDING_ARRAYS`: the poses and actions of some episodes; none of a task without poses.

    Args:
        chosen: (F,) the episodes; by default the first few of each configuration.

    Returns:
        `recorded` (F,), the episodes; `poses` (F, L + 1, 7) and `actions` (F, L, …), where L is the
        longest one's length.
    """
    if result.poses is None:
        return {}
    chosen = _some_of_each(result.config_id) if chosen is None else chosen
    longest = int(result.lengths[chosen].max())
    recording = chosen, result.poses[chosen, : longest + 1], result.actions[chosen, :longest]
    return dict(zip(RECORDING_ARRAYS, recording, strict=True))


def _some_of_each(config_id: np.ndarray) -> np.ndarray:
    """Episodes by configuration, the first few of each."""
    order, place = in_order(config_id)
    chosen = order[place < RECORDED]
    # Of many, some of all: the configurations may be in an order.
    return chosen[np.linspace(0, len(chosen) - 1, min(len(chosen), MOST_RECORDED)).astype(int)]
