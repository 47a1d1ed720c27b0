"""What the examples are examples of is learned, with physics and as long as they take."""

import importlib
import sys

import pandas as pd
import pytest
from test_examples import EXAMPLES

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def found_by_name(monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path, str(EXAMPLES)])


def test_a_task_of_ones_own():
    assert importlib.import_module("own_task").main(iterations=80)["goal_ratio"] >= 0.9


def test_what_is_learned_in_many_maps_holds_in_others():
    seen, unseen = importlib.import_module("many_maps").main(iterations=100, number=1000)
    assert 0.8 <= seen <= 1 and 0.8 <= unseen <= 1


def test_an_environment_of_gymnax():
    pytest.importorskip("gymnax")
    assert importlib.import_module("gymnax_cartpole").main(iterations=100) >= 0.6


def test_a_sampler_of_ones_own(tmp_path, capsys):
    importlib.import_module("own_sampler").main("smoke", tmp_path)
    results = pd.read_csv(tmp_path / "own-sampler-smoke" / "results.csv")
    assert set(results.sampler) == {"own_sampler:Learnability", "pec", "uniform"}
    assert "Learnability" in capsys.readouterr().out
