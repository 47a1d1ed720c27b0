r"""How far the failures that a run's sampler counted are from those of its policy.

    pecjax train --task.space rooms-pairs --iterations 160 --evaluation.every 40 --configurations-every 40 \
        --out runs/pairs
    python benchmarks/failure_counts.py runs/pairs

At each checkpoint the policy flies every configuration that it is trained in, by its most likely actions and
by drawn ones, as in training. Beside these are the failure ratios that were counted: since the beginning, as
PEC counts them, and since the checkpoint before.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from pecjax.curriculum import Outcomes, count_outcomes, pec
from pecjax.envs.task import EvalSet
from pecjax.runtime.devices import use_all_cores
from pecjax.training.checkpoint import Checkpoints
from pecjax.training.load import Trained, open_run
from pecjax.training.run_directory import RunDirectory

FLIGHTS = 20  # of each configuration


def flown(trained: Trained, greedy: bool) -> np.ndarray:
    """Trials and failures (2, N) of flights in each configuration that the run trains in."""
    run, number = trained.run, trained.run.num_configs
    about = dataclasses.replace(trained.settings.evaluation, episodes=FLIGHTS * number, greedy=greedy)
    there = trained._replace(settings=dataclasses.replace(trained.settings, evaluation=about))
    result = there.elsewhere(run.world, EvalSet(run.world.table)).evaluator()()
    return np.asarray(count_outcomes(Outcomes(result.config_id, True, ~result.success), number))


def failure_ratios(counts: np.ndarray) -> np.ndarray:
    """The failure ratio (N,) of trials and failures (2, N), NaN where there is no trial."""
    trials, failures = counts
    return np.where(trials > 0, failures / np.maximum(trials, 1), np.nan)


def draws(counts: np.ndarray) -> np.ndarray:
    """PEC's probabilities (N,) by these trials and failures (2, N)."""
    sampler = pec(counts.shape[1])
    return np.asarray(sampler.probabilities(sampler.init()._replace(statistics=jnp.asarray(counts))))


def compare(counts: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Each kind of counts (2, N) beside the last.

    Draws that differ are half of the sum of the differences of PEC's probabilities (total variation).
    """
    truth = [*counts.values()][-1]
    return [
        {
            "failures": name,
            "mean": np.nanmean(failure_ratios(of)),
            "rank correlation": spearmanr(
                failure_ratios(of), failure_ratios(truth), nan_policy="omit"
            ).statistic,
            "draws that differ": np.abs(draws(of) - draws(truth)).sum() / 2,
        }
        for name, of in counts.items()
    ]


def main(words: list[str] | None = None) -> None:
    """Prints a table of all checkpoints."""
    parser = argparse.ArgumentParser(description="Failures that were counted beside those of the policy.")
    parser.add_argument("run", type=Path)
    folder = parser.parse_args(words).run
    directory, rows = RunDirectory(folder), []
    before: Any = 0
    for iteration in Checkpoints(folder).iterations():
        arrays, trained = directory.arrays("configurations", iteration), open_run(folder, iteration)
        counts = np.stack([arrays["trials"], arrays["failures"]])
        kinds = {
            "counted since the beginning": counts,
            "counted since the row above": counts - before,
            "drawn actions": flown(trained, greedy=False),
            "most likely actions": flown(trained, greedy=True),
        }
        rows += [{"iteration": iteration} | row for row in compare(kinds)]
        before = counts
    print(pd.DataFrame(rows).to_string(index=False, float_format="{:.3f}".format))


if __name__ == "__main__":
    use_all_cores()
    main()
