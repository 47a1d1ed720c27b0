"""Measures over the episodes of an evaluation."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from pecjax.envs.task import EvalSet
from pecjax.training.run_episodes import EvalResult, in_order, success_by_config

WORST = 0.1  # the share of the flown configurations that CVaR averages
PATH_LENGTH = "path_length"  # the metric of a task whose paths have a length, m
CONFIDENCE = 0.95


def cvar(ratios: np.ndarray) -> np.ndarray:
    """CVaR-10 %: the mean over the worst tenth of the configurations that were flown.

    Args:
        ratios: (…, N) goal ratios, NaN where a configuration was not flown.

    Returns:
        (…) the mean of the lowest round(F / 10), at least one, of the F ratios that are numbers in a
        row; NaN in a row that has none.
    """
    flown = np.isfinite(ratios).sum(axis=-1)
    number = np.maximum(1, np.rint(WORST * flown))
    worst = np.arange(ratios.shape[-1]) < number[..., None]
    total = np.sum(np.sort(ratios, axis=-1), axis=-1, where=worst)  # NaN sorts last
    return total / number


def unbiased_cvar(config_id: np.ndarray, success: np.ndarray, num_configs: int) -> float | None:
    """CVaR-10 %, ranked by one half of each configuration's episodes and reported on the other.

    The lowest of many noisy ratios are low by chance too; on other episodes they are not. The halves
    change places, and the mean of both is given. None where a configuration has one episode only.

    Args:
        config_id, success: (E,), of each episode.
    """
    order, place = in_order(config_id)
    halves = []
    for half in (0, 1):
        of = order[place % 2 == half]
        halves.append(success_by_config(config_id[of], success[of], num_configs))
    both = np.isfinite(halves).all(axis=0)
    if not both.any() or not np.array_equal(np.unique(config_id), np.flatnonzero(both)):
        return None
    number = max(1, round(WORST * int(both.sum())))
    figures = []
    for ranked, reported in (halves, halves[::-1]):
        worst = np.argsort(ranked[both], kind="stable")[:number]
        figures.append(float(reported[both][worst].mean()))
    return float(np.mean(figures))


def spl(result: EvalResult, about: EvalSet) -> float | None:
    """Success weighted by path length (Anderson et al. 2018), None where paths have no length.

    The mean of S ℓ / max(p, ℓ) over the episodes: S is 1 for a success and 0 for a failure, p the
    length that was flown and ℓ that of the shortest path.
    """
    if about.shortest is None or PATH_LENGTH not in result.metrics:
        return None
    shortest = np.maximum(about.shortest[result.config_id], 1e-6)
    return float(np.mean(result.success * shortest / np.maximum(result.metrics[PATH_LENGTH], shortest)))


def by_group(result: EvalResult, about: EvalSet) -> list[tuple[str, np.ndarray]]:
    """Which episodes (E,) bool are of each group, by its name; nothing where there is one group."""
    if about.group_id is None:
        return []
    group = np.asarray(about.group_id)[result.config_id]
    return [(name, group == number) for number, name in enumerate(about.groups)]


def only(result: EvalResult, chosen: np.ndarray) -> EvalResult:
    """The episodes (E,) bool that are chosen."""
    return jax.tree.map(lambda leaf: leaf[chosen], result)


def wilson(successes: int, episodes: int) -> tuple[float, float]:
    """The 95 % interval of a ratio of independent successes (Wilson 1927)."""
    from scipy import stats  # takes a second to import

    interval = stats.binomtest(successes, episodes).proportion_ci(CONFIDENCE, "wilson")
    return float(interval.low), float(interval.high)


def figures_of(result: EvalResult, about: EvalSet, num_configs: int) -> dict[str, Any]:
    """The figures of some episodes, with the 95 % interval of their goal ratio.

    The interval is over these episodes as they were drawn, not over trainings.
    """
    episodes, successes = len(result.success), int(result.success.sum())
    if not episodes:
        return {"episodes": 0}
    metrics = {name: float(value.mean()) for name, value in sorted(result.metrics.items())}
    return {
        "episodes": episodes,
        "goal_ratio": successes / episodes,
        "interval": list(wilson(successes, episodes)),
        "spl": spl(result, about),
        "unbiased_cvar": unbiased_cvar(result.config_id, result.success, num_configs),
        "steps_to_goal": float(result.lengths[result.success].mean()) if successes else None,
        "mean_return": float(result.returns.mean()),
        **metrics,
    }
