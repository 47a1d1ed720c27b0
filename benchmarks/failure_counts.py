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

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from pecjax.envs.task import EvalSet
from pecjax.runtime.devices import use_all_cores
from pecjax.training.load import Trained, open_run
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_episodes import success_by_config

FLIGHTS = 20  # of each configuration
ALPHA = 0.2  # of PEC


def flown(trained: Trained, greedy: bool) -> np.ndarray:
    """The failure ratio (N,) of each configuration that the run trains in."""
    run, number = trained.run, trained.run.num_configs
    about = dataclasses.replace(trained.settings.evaluation, episodes=FLIGHTS * number, greedy=greedy)
    there = trained._replace(settings=dataclasses.replace(trained.settings, evaluation=about))
    result = there.elsewhere(run.world, EvalSet(run.world.table)).evaluator()()
    return 1 - success_by_config(result.config_id, result.success, number)


def counted(new: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The failure ratio (N,) of trials and failures (2, N) since those before, NaN where there is none."""
    trials, failures = new - before
    return np.where(trials > 0, failures / np.maximum(trials, 1), np.nan)


def draws(ratios: np.ndarray) -> np.ndarray:
    """PEC's probabilities (N,) for these failure ratios."""
    weights = np.where(np.isnan(ratios), 1.0, ratios + ALPHA)
    return weights / weights.sum()


def compare(ratios: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Each kind of ratios beside the last.

    Draws that differ are half of the sum of the differences of PEC's probabilities (total variation).
    """
    truth = [*ratios.values()][-1]
    return [
        {
            "failures": name,
            "mean": np.nanmean(of),
            "rank correlation": spearmanr(of, truth, nan_policy="omit").statistic,
            "draws that differ": np.abs(draws(of) - draws(truth)).sum() / 2,
        }
        for name, of in ratios.items()
    ]


def main(words: list[str] | None = None) -> None:
    """Prints a table of all checkpoints."""
    parser = argparse.ArgumentParser(description="Failures that were counted beside those of the policy.")
    parser.add_argument("run", type=Path)
    folder = parser.parse_args(words).run
    directory, rows = RunDirectory(folder), []
    before = 0
    for iteration in sorted(int(path.stem) for path in (folder / "checkpoints").glob("*.npz")):
        arrays, trained = directory.arrays("configurations", iteration), open_run(folder, iteration)
        counts = np.stack([arrays["trials"], arrays["failures"]])
        ratios = {
            "counted since the beginning": counted(counts, np.zeros_like(counts)),
            "counted since the row above": counted(counts, np.zeros_like(counts) + before),
            "drawn actions": flown(trained, greedy=False),
            "most likely actions": flown(trained, greedy=True),
        }
        rows += [{"iteration": iteration} | row for row in compare(ratios)]
        before = counts
    print(pd.DataFrame(rows).to_string(index=False, float_format="{:.3f}".format))


if __name__ == "__main__":
    use_all_cores()
    main()
