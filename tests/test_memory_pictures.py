"""docs/memory_pictures.py: what it draws and what the page says are the numbers of the stored table."""

import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

DOCS = Path(__file__).parents[1] / "docs"
SPEC = importlib.util.spec_from_file_location("memory_pictures", DOCS / "memory_pictures.py")
pictures = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(pictures)


@pytest.mark.parametrize("space", pictures.NETWORKS)
def test_every_run_of_what_is_drawn_is_a_curve(space):
    table, looks = pd.read_csv(pictures.stored(space)), pictures.LOOKS[space]
    runs = [run for (network, _), run in table.groupby(["network", "seed"]) if network in looks]
    assert {run.network.iloc[0] for run in runs} == set(looks)
    by_steps, by_minutes = pictures.curves(space, table).axes
    for axes, column, unit in ((by_steps, "env_steps", 1e6), (by_minutes, "seconds", 60)):
        drawn = sorted(tuple(line.get_xydata().ravel().round(9)) for line in axes.lines)
        wanted = [np.stack([run[column] / unit, run.goal_ratio], axis=1) for run in runs]
        assert drawn == sorted(tuple(points.ravel().round(9)) for points in wanted)


@pytest.mark.parametrize("space", pictures.NETWORKS)
def test_the_page_has_the_ends_of_the_table(space):
    page = (DOCS / "memory.md").read_text()
    assert f"images/results/memory-{space}.png" in page
    for network, ratios in pictures.ends(space, pd.read_csv(pictures.stored(space))).items():
        figures = ["" if np.isnan(ratio) else f"{ratio:.3f}" for ratio in ratios]
        row = " | ".join([pictures.NETWORKS[space][network][0], *figures])
        assert f"| {row} |".replace("  ", " ") in page


def test_the_page_has_the_runs_in_one_map():
    page = (DOCS / "memory.md").read_text()
    runs = pd.read_csv(DOCS / "results" / "memory-pairs-runs.csv")
    names = {"none": "none", "gru": "GRU", "mingru": "minGRU", "stack": "stack"}
    for memory, of in runs.groupby(runs["agent.network.memory"].fillna("none")):
        ends = ", ".join(f"{ratio:.3f}" for ratio in of.sort_values("seed").goal_ratio)
        assert f"| {names[memory]} | {ends} | {of.area_under_curve.mean():.3f} |" in page


def test_runs_are_collected_with_their_seconds(tmp_path):
    run = tmp_path / "mingru-7"
    run.mkdir()
    (run / "metrics.csv").write_text("iteration,seconds\n1,2.5\n2,5.0\n3,7.5\n")
    (run / "evaluation.csv").write_text("iteration,env_steps,goal_ratio\n1,10,0.25\n3,30,0.75\n")
    found = pictures.collect(tmp_path)
    assert found.network.tolist() == ["mingru"] * 2 and found.seed.tolist() == [7, 7]
    assert found.seconds.tolist() == [2.5, 7.5] and found.goal_ratio.tolist() == [0.25, 0.75]
    assert pictures.ends("floorplans", found).loc[7, "mingru"] == 0.5


def test_a_run_takes_the_place_of_its_former_self():
    columns = ["network", "seed", "iteration", "goal_ratio"]
    table = pd.DataFrame(
        [["mlp", 0, 1, 0.1], ["mingru", 0, 1, 0.2], ["mingru", 0, 2, 0.3], ["mingru", 1, 1, 0.4]],
        columns=columns,
    )
    new = pd.DataFrame([["mlp", 1, 1, 0.5], ["mingru", 0, 1, 0.6]], columns=columns)
    found = pictures.joined("floorplans", table, new)
    assert found.values.tolist() == [
        ["mlp", 0, 1, 0.1], ["mlp", 1, 1, 0.5], ["mingru", 0, 1, 0.6], ["mingru", 1, 1, 0.4]
    ]  # fmt: skip
