"""The report of a study in Markdown, and reports that are made again from batches alone."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from synthetic import study_settings, write_study

from pecjax import InputError, cli
from pecjax.storage import files
from pecjax.studies.comparison import holm
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.measures import group_columns, paired, summary
from pecjax.studies.report import markdown_report, write_report

STORED = sorted((Path(__file__).parents[1] / "docs" / "results" / "paper").glob("*"))
LONGTAIL = [STORED[0].parents[1] / name for name in ("longtail-alpha", "longtail-forgetting")]
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


def test_its_numbers_are_those_of_the_tables(study):
    write_report(study)
    first, second = (study / "report.md").read_text().split("\n## set 2: 3 seeds\n")
    ends, pairs = first.split(f"\nIn pairs, {PEC} - uniform:\n")
    assert ends.startswith(f"## set 1: 3 seeds\n\n|  | {PEC} | uniform |\n")
    assert list(cells(second.partition("In pairs")[0])) == list(cells(ends))
    summary = pd.read_csv(study / "summary.csv").query("coordinates == 1").set_index("condition")
    paired = pd.read_csv(study / "paired.csv").query("coordinates == 1").set_index("measure")
    row, ended, compared = summary.loc[PEC], cells(ends), cells(pairs)
    at_the_end = f"{row.goal_ratio:.3f} [{row.goal_ratio_low:.3f}, {row.goal_ratio_high:.3f}]"
    assert ended["goal ratio at the end"][0] == at_the_end
    trials = summary.loc["uniform", "greatest_trial_ratio"]
    assert ended["in training: greatest share of trials"][1].startswith(f"{trials:.3f} [")
    median, least, greatest = (row[f"steps_to_0.9_{which}"] / 1e6 for which in ("median", "min", "max"))
    assert ended["million steps until 0.9 is held"][0] == f"{median:.2f} ({least:.2f}-{greatest:.2f})"
    pair = paired.loc["steps_to_0.9"]
    value, low, high = (pair[f"difference{end}"] / 1e6 for end in ("", "_low", "_high"))
    wanted = ["3 / 0 / 0", f"{value:+.2f} [{low:+.2f}, {high:+.2f}]", f"{pair.p:.2g}"]
    assert compared["million steps until 0.9 is held"] == wanted and value < 0
    assert np.isinf(row["steps_to_0.95_max"]) and row["steps_to_0.95_reached"] == 2
    assert ended["million steps until 0.95 is held"][0].endswith("-never), 2 of 3")
    assert compared["million steps until 0.95 is held"][1].endswith(" over 2 pairs")


def test_each_comparison_has_a_table_and_what_is_unknown_is_left_out(tmp_path):
    settings = study_settings((0.2, 3.0), seeds=(4,))
    write_report(write_study(tmp_path / "study", settings, lambda run, progress: 0.5 * progress))
    text = (tmp_path / "study" / "report.md").read_text()
    ends, *compared = text.split("In pairs, ")
    assert f"|  | {PEC} | uniform | pec, α = 3 |\n" in ends
    assert [part.partition(":")[0] for part in compared] == [f"{PEC} - uniform", "pec, α = 3 - uniform"]
    assert text.startswith("## set 1: 1 seed\n") and "nan" not in text and "inf" not in text
    assert cells(ends)["million steps until 0.9 is held"] == ["never"] * 3
    assert cells(compared[0])["goal ratio at the end"] == ["0 / 1 / 0", "+0.000", "1"]
    assert cells(compared[0])["million steps until 0.9 is held"][0] == "0 / 1 / 0"


def test_a_condition_with_fewer_seeds_says_so(study):
    write_report(study)
    summaries = pd.read_csv(study / "summary.csv", dtype={"coordinates": str}).to_dict("records")[-2:]
    summaries[1]["seeds"] = 2
    assert f"## set 2: 3 seeds\n\n|  | {PEC} | uniform (2 seeds) |\n" in markdown_report(summaries, [])


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


def test_what_cannot_be_made_again_gets_one_line(study, tmp_path, capsys):
    folder, batches = tmp_path / "study", tmp_path / "study" / "batches"
    shutil.copytree(study, folder)
    again = ["study", "report", "--out", str(folder)]
    with files.alone(folder):
        assert cli.main(again) == 2
    assert "another process trains here" in capsys.readouterr().err
    shutil.rmtree(batches / "0011")
    assert StudyDirectory(folder).rebuild_tables() == [f"{folder}: 11 of 12 batches are there"]
    table = batches / "0003" / "metrics.csv"
    table.write_text(table.read_text().replace("0.", "1.", 1))
    assert cli.main(again) == 2
    assert "0003: not as it was written; resume the study" in capsys.readouterr().err
    shutil.rmtree(batches)
    with pytest.raises(InputError, match="none is there; resume the study"):
        StudyDirectory(folder).rebuild_tables()


def stored_batches(stored, folder):
    for name in ("batches", "task-0"):
        shutil.copytree(stored / name, folder / name)
    shutil.copy(stored / "study.json", folder)


@pytest.mark.parametrize("stored", STORED, ids=lambda folder: folder.name)
def test_stored_studies_have_the_tables_of_their_batches(stored, tmp_path):
    stored_batches(stored, tmp_path)
    StudyDirectory(tmp_path).rebuild_tables()
    write_report(tmp_path)
    for name in REPORT:
        assert (tmp_path / name).read_bytes() == (stored / name).read_bytes()


@pytest.mark.parametrize("stored", LONGTAIL, ids=lambda folder: folder.name)
def test_studies_that_are_stored_without_batches_have_the_report_of_their_runs(stored):
    runs = pd.read_csv(stored / "runs.csv", dtype={"coordinates": str})
    text = markdown_report([*summary(runs)], [*paired(runs)], group_columns(runs))
    assert text == (stored / "report.md").read_text()


def test_what_the_page_says_of_alpha_and_forgetting_is_what_the_stored_studies_have():
    tables = [pd.read_csv(folder / "paired.csv") for folder in LONGTAIL]
    found = pd.concat(tables).query("measure == 'goal_ratio.hard'")
    page = " ".join((STORED[0].parents[2] / "benchmark.md").read_text().split())
    assert list(found.baseline.unique()) == [PEC] and len(found) == 4
    for row, corrected in zip(found.itertuples(), holm(found.p.to_numpy()), strict=True):
        value = f"{row.difference:+.2f} [{row.difference_low:+.2f}, {row.difference_high:+.2f}]"
        assert f"| {row.condition} | {value} | {row.better} of 10 | {row.p:.2g} | {corrected:.2g} |" in page


def test_what_the_page_says_of_the_hint_is_what_the_stored_study_has():
    results = pd.read_csv(STORED[0].parent / "fig4-early" / "results.csv")
    early = results[results.iteration.isin([60, 80, 100])].groupby(["seed", "sampler"]).goal_ratio.mean()
    differences = (early.xs("pec", level="sampler") - early.xs("uniform", level="sampler")).to_numpy()
    interval = stats.ttest_1samp(differences, 0).confidence_interval()
    page = " ".join((STORED[0].parents[2] / "paper.md").read_text().split())
    said = f"{differences.mean():.3f} [{interval.low:.3f}, {interval.high:.3f}]"
    assert f"PEC is above in two pairs, alike in one, below in five: {said}" in page
    assert [(differences > 1e-9).sum(), (abs(differences) < 1e-9).sum(), len(differences)] == [2, 1, 8]


@pytest.mark.slow
@pytest.mark.parametrize("stored", STORED, ids=lambda folder: folder.name)
def test_stored_studies_have_the_figures_of_their_batches(stored, tmp_path):
    stored_batches(stored, tmp_path)
    assert cli.main(["study", "report", "--out", str(tmp_path)]) == 0
    figures = [path.relative_to(stored) for path in stored.glob("figures/*.png")]
    assert figures
    for name in figures:
        assert (tmp_path / name).read_bytes() == (stored / name).read_bytes()
