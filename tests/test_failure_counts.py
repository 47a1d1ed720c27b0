"""benchmarks/failure_counts.py: the table of a run, and its figures beside those by hand."""

import importlib.util
import itertools
from pathlib import Path

import numpy as np
import pytest

import pecjax

FILE = Path(__file__).parents[1] / "benchmarks" / "failure_counts.py"
SPEC = importlib.util.spec_from_file_location("failure_counts", FILE)
failure_counts = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(failure_counts)


def test_ratios_are_of_what_was_tried():
    counts = np.array([[4, 0, 3, 2], [1, 0, 0, 2]])
    np.testing.assert_array_equal(failure_counts.failure_ratios(counts), [0.25, np.nan, 0, 1])


def test_draws_and_ranks_are_those_by_hand():
    counted, truth = np.array([[10, 10, 0, 5], [1, 9, 0, 2]]), np.array([[10, 10, 10, 10], [0, 5, 10, 7]])
    row, same = failure_counts.compare({"counted": counted, "truth": truth})
    weights = np.array([[0.3, 1.1, 1.0, 0.6], [0.2, 0.7, 1.2, 0.9]])
    ours, theirs = weights / weights.sum(axis=1, keepdims=True)
    assert row["draws that differ"] == pytest.approx(np.maximum(ours - theirs, 0).sum())
    ratios = (0.1, 0.9, None, 0.4), (0.0, 0.5, 1.0, 0.7)
    pairs = itertools.combinations([0, 1, 3], 2)
    assert [(ratios[0][a] < ratios[0][b]) == (ratios[1][a] < ratios[1][b]) for a, b in pairs] == [1, 1, 0]
    assert row["mean"] == pytest.approx(1.4 / 3) and row["rank correlation"] == pytest.approx(0.5)
    assert same["draws that differ"] == 0 and same["rank correlation"] == pytest.approx(1)


@pytest.mark.slow
def test_it_has_four_rows_for_each_checkpoint(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(failure_counts, "FLIGHTS", 2)
    settings = pecjax.set_path(pecjax.RunSettings(), "stop.iterations", 4)
    for path, value in {"evaluation.every": 2, "evaluation.episodes": 20, "configurations_every": 2}.items():
        settings = pecjax.set_path(settings, path, value)
    pecjax.train(settings, tmp_path / "run")
    failure_counts.main([str(tmp_path / "run")])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 2 * 4 and [line.split()[0] for line in lines[1::4]] == ["2", "4"]
    assert all(line.endswith("0.000") for line in lines[4::4])
