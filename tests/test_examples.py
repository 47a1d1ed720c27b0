"""The examples: each runs, is short, and needs nothing but what pecjax offers."""

import importlib
import sys
from pathlib import Path

import pandas as pd
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


def test_examples_are_short():
    for path in EXAMPLES.glob("*.py"):
        assert path.read_text().count("\n") <= 80 and "def main(" in path.read_text(), path


@pytest.mark.slow
def test_a_sampler_of_ones_own(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", [*sys.path, str(EXAMPLES)])
    importlib.import_module("own_sampler").main("smoke", tmp_path)
    results = pd.read_csv(tmp_path / "own-sampler-smoke" / "results.csv")
    assert set(results.sampler) == {"own_sampler:Learnability", "pec", "uniform"}
    assert "Learnability" in capsys.readouterr().out
