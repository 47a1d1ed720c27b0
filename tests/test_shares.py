"""Shares of a training's steps, by what could be learned from them, beside counting by hand."""

import numpy as np
import pandas as pd
import pytest
from synthetic import study_settings, write_study

from pecjax.studies.shares import KINDS, kinds_of, mean_shares, shares, write_shares


def test_kinds_are_by_the_goal_ratio_of_all_runs_together():
    # Two runs, one stretch, four configurations: never reached, always, half of the time, hardly flown.
    trials = np.array([[[40, 30, 20, 1]], [[40, 30, 20, 0]]])
    failures = np.array([[[40, 0, 0, 1]], [[40, 0, 20, 0]]])
    assert kinds_of(trials, failures).tolist() == [[0, 2, 1, 1]]
    steps = trials * np.array([5, 10, 20, 100])
    found = shares(steps, kinds_of(trials, failures))
    np.testing.assert_allclose(found[0, 0], [200 / 1000, 500 / 1000, 300 / 1000])
    np.testing.assert_allclose(found.sum(axis=-1), 1)
    assert (shares(0 * steps, kinds_of(trials, failures)) == 0).all(), "of no steps there are no shares"


@pytest.mark.parametrize(("ratio", "kind"), [(0.0, 0), (0.05, 0), (0.2, 1), (0.8, 1), (0.95, 2), (1.0, 2)])
def test_kinds_end_where_they_say(ratio, kind):
    trials = np.full((1, 1, 3), 10_000)
    failures = np.round(trials * (1 - ratio)).astype(int)
    assert (kinds_of(trials, failures) == kind).all()


def test_a_study_has_a_row_for_each_run_and_evaluation(tmp_path):
    folder = write_study(tmp_path, study_settings(), lambda run, part: part)
    write_shares(folder)
    found = pd.read_csv(folder / "shares.csv")
    results = pd.read_csv(folder / "results.csv")
    assert list(found) == ["condition", "seed", "env_steps", *KINDS]
    assert len(found) == len(results) and set(found.env_steps) == set(results.env_steps)
    np.testing.assert_allclose(found[[*KINDS]].sum(axis=1), 1, rtol=1e-6)
    means = mean_shares(found)
    first = found[(found.condition == found.condition[0]) & (found.env_steps == found.env_steps[0])]
    assert len(first) == results.seed.nunique() > 1
    np.testing.assert_allclose(
        means.loc[0, [*KINDS]].tolist(), [sum(first[kind]) / len(first) for kind in KINDS]
    )
