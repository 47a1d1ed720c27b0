"""The examples: each runs, is short, and needs nothing but what pecjax offers."""

import importlib
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from contract_task import check_task

import pecjax
from pecjax.envs.task import take_configs

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(autouse=True)
def around_flights(gliding, monkeypatch):
    """What is tested here does not depend on how the drone flies."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(EXAMPLES)])


def test_examples_are_short():
    for path in EXAMPLES.glob("*.py"):
        assert path.read_text().count("\n") < 80 and "def main(" in path.read_text(), path


def test_the_tasks_of_the_examples_keep_to_the_contract():
    assert check_task(*importlib.import_module("own_task").PuckSettings().make(), steps=210) > 0
    assert check_task(*importlib.import_module("many_maps").Halls(number=5).make(), steps=40) > 0


def test_a_task_of_ones_own():
    row = importlib.import_module("own_task").main(iterations=2)
    assert 0 <= row["goal_ratio"] <= 1 and 0 < row["effort"] < 1


def test_an_axis_of_ones_own_is_read_flown_and_kept(tmp_path, capsys):
    example = importlib.import_module("own_axis")
    ratios = example.main(iterations=2, episodes=1, folder=tmp_path / "narrow")
    assert ratios.shape == (3,) and np.isfinite(ratios).all()
    assert "view" in capsys.readouterr().out
    kept = (tmp_path / "narrow" / "run" / "coordinates.csv").read_text().splitlines()
    assert kept[0] == "# start_x,start_y,goal_x,goal_y,view" and kept[2] == "0,-2,5,-2,0.5"
    task, world = example.NarrowRooms(table=str(tmp_path / "narrow" / "narrow.csv")).make()
    assert check_task(task, world, steps=30) > 0
    key = jax.random.key(3)
    seen = [
        task.observe(key, task.reset(key, take_configs(world.table, row), None), world.params)["depth"]
        for row in range(3)
    ]
    kept = np.arange(16) // 4 % 3 != 0  # the middle half of the columns
    np.testing.assert_array_equal(seen[1], np.where(kept, seen[0], 1.0))
    assert (seen[0] < 1).any() and (seen[2] == 1).all()


def test_many_maps_are_flown_seen_and_unseen(capsys):
    seen, unseen = importlib.import_module("many_maps").main(iterations=2, number=50)
    assert 0 <= seen <= 1 and 0 <= unseen <= 1
    assert "never seen" in capsys.readouterr().out


def test_an_environment_of_gymnax():
    pytest.importorskip("gymnax")
    example = importlib.import_module("gymnax_cartpole")
    assert check_task(*example.Poles().make(), steps=60) > 0
    assert 0 <= example.main(iterations=2) <= 1


@pytest.mark.slow
def test_a_search_ends_trainings_that_fall_behind(capsys, monkeypatch):
    optuna = pytest.importorskip("optuna")
    monkeypatch.setattr(optuna.pruners, "MedianPruner", lambda **_: FromTheSecond())

    class FromTheSecond(optuna.pruners.BasePruner):
        def prune(self, study, trial):
            return trial.number > 0

    puck = importlib.import_module("own_task").PuckSettings(number=3)
    base = pecjax.RunSettings(task=puck, agent=pecjax.agents.PPO(num_envs=8))
    study = importlib.import_module("search").main(trials=2, iterations=2, every=1, base=base)
    finished, pruned = study.trials
    assert 0 <= finished.value <= 1 and [*finished.intermediate_values] == [1]
    assert pruned.state == optuna.trial.TrialState.PRUNED
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith(f"goal ratio {finished.value:.3f}") and lines[1].endswith("(ended early)")
