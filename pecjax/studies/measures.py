"""What a study measures: how each run and condition ended, and paired differences between conditions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from pecjax.storage.tables import Row
from pecjax.studies.statistics import (
    Interval,
    area_under_curve,
    interval,
    paired_difference,
    sign_flip_p,
    steps_to_exit,
    steps_to_threshold,
    trial_and_failure_ratios,
)
from pecjax.studies.tables import StudyTables, varied_columns

THRESHOLDS = (0.9, 0.95)
BASELINE = "uniform"  # what others are paired with; the study's first condition where it is not there
RATIOS = ("goal_ratio", "cvar", "area_under_curve", "cvar_area_under_curve")
# Of what the sampler drew in training: beside the paper's figures, not to compare samplers by.
TRAINING = ("training_goal_ratio", "failure_ratio", "least_trial_ratio", "greatest_trial_ratio")
UNKNOWN = Interval(*[float("nan")] * 3)
LAST_ITERATIONS = 100  # that the paper takes the mean training goal ratio of
STEPS = tuple(f"{what}_{at:g}" for at in THRESHOLDS for what in ("steps_to", "exit_at"))


def by_run(tables: StudyTables) -> pd.DataFrame:
    """One row a run: how it ended, and how soon it came to the thresholds.

    Columns: `goal_ratio` (of all configurations and of each group) and `cvar` of the last evaluation, the
    `area_under_curve` of `goal_ratio` and of `cvar`,
    `steps_to_0.9` (environment steps at the first of five evaluations in a row that hold it) and
    `exit_at_0.9` (at the fifth iteration in a row whose training goal ratio holds it: the paper's
    exit condition); inf where it was not reached. Of training: `training_goal_ratio`, the mean of the
    last 100 iterations; `failure_ratio`, the mean over the configurations, `least_trial_ratio` and
    `greatest_trial_ratio`, all since the run began.
    """
    keys = ["coordinates", "condition", "seed"]
    last = tables.configurations.iteration.max()
    counts = tables.configurations.loc[tables.configurations.iteration == last]
    draws = trial_and_failure_ratios(counts, keys).groupby(keys, sort=False)
    trainings = tables.metrics.groupby(keys, sort=False)
    rows = []
    for key, run in tables.results.groupby(keys, sort=False):
        training, drawn = trainings.get_group(key), draws.get_group(key)
        steps, ratios = run.env_steps.to_numpy(), run.goal_ratio.to_numpy()
        row = run[[*keys, "sampler", "alpha", *varied_columns(run)]].iloc[0].to_dict() | {
            "goal_ratio": ratios[-1],
            **run[group_columns(run)].iloc[-1],
            "cvar": run.cvar.iloc[-1],
            "area_under_curve": area_under_curve(steps, ratios),
            "cvar_area_under_curve": area_under_curve(steps, run.cvar.to_numpy()),
        }
        for at in THRESHOLDS:
            row[f"steps_to_{at:g}"] = steps_to_threshold(steps, ratios, at)
            row[f"exit_at_{at:g}"] = steps_to_exit(
                training.env_steps.to_numpy(), training.goal_ratio.to_numpy(), at
            )
        row |= {
            "training_goal_ratio": training.goal_ratio.tail(LAST_ITERATIONS).mean(),
            "failure_ratio": drawn.failure.mean(),
            "least_trial_ratio": drawn.trial.min(),
            "greatest_trial_ratio": drawn.trial.max(),
        }
        rows.append(row)
    return pd.DataFrame(rows)


def group_columns(table: pd.DataFrame) -> list[str]:
    """The columns of goal ratios of groups of configurations, of a study's results or of its runs."""
    return [name for name in table.columns if name.startswith("goal_ratio.")]


def summary(runs: pd.DataFrame) -> Iterator[Row]:
    """One row a condition: interquartile means with intervals, medians and ranges of steps."""
    keys = ["coordinates", "condition"]
    for _, rows in runs.groupby(keys, sort=False):
        row = rows[keys].iloc[0].to_dict() | {"seeds": len(rows)}
        for name in (*RATIOS, *group_columns(rows)):
            values = rows[name].to_numpy()
            row |= _columns(name, UNKNOWN if np.isnan(values).any() else interval(values))
        for name in STEPS:
            row[f"{name}_reached"] = int(np.isfinite(rows[name]).sum())
            spread = rows[name].agg(["median", "min", "max"])
            row |= {f"{name}_{which}": figure for which, figure in spread.items()}
        for name in TRAINING:
            row |= _columns(name, interval(rows[name].to_numpy()))
        yield row


def paired(runs: pd.DataFrame) -> Iterator[Row]:
    """One row a condition and measure: differences from the baseline, seed by seed.

    Where settings of the learner vary too, the baseline has the same ones.
    """
    for coordinates, rows in _comparable(runs):
        ratios = (*RATIOS, *group_columns(rows.dropna(axis=1, how="all")))
        table = rows.pivot(index="seed", columns="condition", values=[*ratios, *STEPS])
        there = list(dict.fromkeys(rows.condition))
        baseline = next((c for c in there if c.partition(",")[0] == BASELINE), there[0])
        for condition in there:
            if condition == baseline:
                continue
            for name in (*ratios, *STEPS):
                pairs = table[name][[condition, baseline]].dropna()
                ours, theirs = pairs[condition].to_numpy(float), pairs[baseline].to_numpy(float)
                better = ours > theirs if name in ratios else ours < theirs
                equal = ours == theirs
                both = np.isfinite(ours) & np.isfinite(theirs)
                head = {"coordinates": coordinates, "condition": condition, "baseline": baseline}
                counts = {
                    "better": int(better.sum()),
                    "equal": int(equal.sum()),
                    "worse": int((~better & ~equal).sum()),
                    "pairs": int(both.sum()),
                }
                found, p = UNKNOWN, float("nan")
                if both.any():
                    found = paired_difference(ours[both], theirs[both])
                    p = sign_flip_p(ours[both] - theirs[both])
                yield head | {"measure": name} | counts | _columns("difference", found) | {"p": p}


def _comparable(runs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """The runs by coordinates, and by the learner's settings where more than one sampler has each."""
    shared = [name for name in varied_columns(runs) if not name.startswith("sampler.")]
    for coordinates, rows in runs.groupby("coordinates", sort=False):
        blocks = [block for _, block in rows.groupby(shared, sort=False, dropna=False)] if shared else [rows]
        alone = all(block.condition.nunique() == 1 for block in blocks)
        for block in [rows] if alone else blocks:
            yield str(coordinates), block


def _columns(name: str, found: Interval) -> dict[str, float]:
    return {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}
