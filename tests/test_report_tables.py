"""The report of a study in Markdown: figures of its tables, and the stored ones made again."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from synthetic import study_settings, write_study

from pecjax import cli
from pecjax.studies.report import write_report
from pecjax.studies.report_tables import report_text

STORED = sorted((Path(__file__).parents[1] / "docs" / "results" / "paper").glob("*"))
REPORT = ("results.csv", "runs.csv", "summary.csv", "paired.csv", "report.md")
PEC = "pec, α = 0.2"


def ratio(run, progress):
    """Rises sooner under PEC, to 0.97 in even seeds and to 0.93 in odd ones."""
    return min(progress * (2.5 if hasattr(run.sampler, "alpha") else 2), 0.97 - 0.04 * (run.seed % 2))


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return write_study(
        tmp_path_factory.mktemp("made") / "study", study_settings(coordinates=("1", "2")), ratio
    )


def cells(text: str) -> dict[str, list[str]]:
    """The rows of Markdown tables by their first column."""
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return {row[0]: row[1:] for row in rows}


def test_its_figures_are_those_of_the_tables(study):
    write_report(study)
    first, second = (study / "report.md").read_text().split("\n## set 2: 3 seeds\n")
    assert first.startswith("## set 1: 3 seeds\n")
    summary = pd.read_csv(study / "summary.csv").query("coordinates == 1").set_index("condition")
    paired = pd.read_csv(study / "paired.csv").query("coordinates == 1").set_index("measure")
    row = summary.loc[PEC]
    found = cells(first)
    assert list(cells(second)) == list(found)
    ended = f"{row.goal_ratio:.3f} [{row.goal_ratio_low:.3f}, {row.goal_ratio_high:.3f}]"
    assert found["goal ratio at the end"][0] == ended
    held, pair = found["million steps until 0.9 is held"], paired.loc["steps_to_0.9"]
    median, least, greatest = (row[f"steps_to_0.9_{which}"] / 1e6 for which in ("median", "min", "max"))
    assert held[0] == f"{median:.2f} ({least:.2f}-{greatest:.2f})" and pair.better == 3
    low, high = pair.difference_low / 1e6, pair.difference_high / 1e6
    assert held[2:] == [
        "3 / 0 / 0",
        f"{pair.difference / 1e6:+.2f} [{low:+.2f}, {high:+.2f}]",
        f"{pair.p:.2g}",
    ]
    assert np.isinf(row["steps_to_0.95_max"]) and row["steps_to_0.95_reached"] == 2
    later = found["million steps until 0.95 is held"]
    assert later[0].endswith("-never), 2 of 3 runs") and later[3].endswith(" over 2 pairs")


def test_several_conditions_have_a_table_each_and_what_is_unknown_is_left_out(tmp_path):
    settings = study_settings((0.2, 3.0), seeds=(4,))
    write_report(write_study(tmp_path / "study", settings, lambda run, progress: 0.5 * progress))
    text = (tmp_path / "study" / "report.md").read_text()
    _, ends, *compared = text.split("\n\n")
    assert ends.startswith(f"|  | {PEC} | uniform | pec, α = 3 |\n") and len(compared) == 2
    assert f"| {PEC} - uniform | p |" in compared[0] and "| pec, α = 3 - uniform | p |" in compared[1]
    assert text.startswith("## set 1: 1 seed\n") and "nan" not in text and "inf" not in text
    assert cells(ends)["million steps until 0.9 is held"] == ["never"] * 3
    assert cells(compared[0])["goal ratio at the end"] == ["0 / 1 / 0", "+0.000", "1"]


def test_groups_are_named():
    row = {"coordinates": "1", "condition": "uniform", "seeds": 2}
    row |= {"goal_ratio.hard": 0.5, "goal_ratio.hard_low": 0.4, "goal_ratio.hard_high": 0.6}
    assert "| hard at the end | 0.500 [0.400, 0.600] |" in report_text([row], [])


def test_it_is_rebuilt_from_the_batches_alone(study, tmp_path, capsys):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    again = ["study", "report", "--out", str(folder)]
    assert cli.main(again) == 0
    files = [*(folder / name for name in (*REPORT, "metrics.csv")), *sorted(folder.glob("figures/*.png"))]
    before = [file.read_bytes() for file in files]
    assert len(files) > 12 and "set 2, uniform, 3 seeds" in capsys.readouterr().out
    for file in files:
        file.unlink()
    assert cli.main(again) == 0
    assert [file.read_bytes() for file in files] == before


@pytest.mark.slow
@pytest.mark.parametrize("stored", STORED, ids=lambda folder: folder.name)
def test_stored_studies_have_the_report_of_their_batches(stored, tmp_path):
    """Figures, too."""
    for name in ("batches", "task-0"):
        shutil.copytree(stored / name, tmp_path / name)
    shutil.copy(stored / "study.json", tmp_path)
    assert cli.main(["study", "report", "--out", str(tmp_path)]) == 0
    figures = [path.relative_to(stored) for path in stored.glob("figures/*.png")]
    assert figures
    for name in (*REPORT, *figures):
        assert (tmp_path / name).read_bytes() == (stored / name).read_bytes()
