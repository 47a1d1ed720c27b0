"""Reports of studies that nobody trained: what belongs to one condition, whatever its α and its place."""

import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from study_of_0_1 import as_version_0_1
from synthetic import study_settings, write_study

import pecjax
from pecjax.envs.task import EvalSet
from pecjax.plotting import study as study_figures, study_curves
from pecjax.studies import measures, report as study_report
from pecjax.studies.collect import Collected
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import shown_space, space_name
from pecjax.studies.run import run_study
from pecjax.studies.tables import read_study
from pecjax.training.rows import evaluation_row
from pecjax.training.run_episodes import EvalResult

# 0.2 and its neighbours among doubles and floats, and α in all the ways that Python writes one.
ALPHAS = (0.2, 0.2000001, 0.20000001, 0.20000000000000004, 0.1 + 0.2, 1e-9, 3.0, 12345678.9, 1e22)


def by_alpha(run, progress):
    alpha = getattr(run.sampler, "alpha", None)
    return progress if alpha is None else ALPHAS.index(alpha) / len(ALPHAS)


@pytest.fixture(scope="module")
def near_alphas(tmp_path_factory):
    settings = study_settings(ALPHAS, seeds=(4, 7))
    return write_study(tmp_path_factory.mktemp("near") / "study", settings, by_alpha)


def test_every_alpha_is_a_condition_of_its_own(near_alphas):
    tables = read_study(near_alphas)
    assert tuple(dict.fromkeys(tables.results.alpha.dropna())) == ALPHAS  # to the last digit
    for table in tables:
        assert table.groupby("condition").ngroups == len(ALPHAS) + 1
    runs = measures.by_run(tables)
    assert len(runs) == 2 * (len(ALPHAS) + 1)
    assert set(runs.condition) >= {"pec, α = 0.2", "pec, α = 0.2000001", "pec, α = 3", "uniform"}
    study_report.write_report(near_alphas)
    written = pd.read_csv(near_alphas / "runs.csv", dtype={"alpha": str})
    assert tuple(map(float, dict.fromkeys(written.alpha.dropna()))) == ALPHAS
    assert len(pd.read_csv(near_alphas / "summary.csv")) == len(ALPHAS) + 1


def test_no_figure_of_a_condition_takes_anothers_place(near_alphas, monkeypatch):
    drawn = []
    parts = ("goal_ratio", "evaluation", "spread", "exits", "steps_to_threshold", "maps", "alphas")
    for part in (*parts, "configurations"):  # only their names matter
        monkeypatch.setattr(study_figures, part, lambda *_: Figure())
    monkeypatch.setattr(study_figures, "save", lambda figure, path: drawn.append(path) or [path])
    study_figures.draw_study(near_alphas)
    assert len(drawn) == len(set(drawn))
    stems = {path.name for path in drawn if path.name.startswith("configurations-")}
    assert len(stems) == len(ALPHAS) + 1
    assert {"configurations-pec-0.2", "configurations-pec-0.2000001", "configurations-pec-3"} <= stems


def test_coordinates_are_told_apart_by_their_text(tmp_path):
    for name in ("1", "01"):
        (tmp_path / name).write_text("0 -2 0.7 -2\n5 -2.4 5 -3.2\n")
    settings = study_settings(coordinates=("1", "01"), seeds=(0,))
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(tmp_path)
        write_study(tmp_path / "study", settings, lambda run, progress: progress)
    tables = read_study(tmp_path / "study")
    assert set(tables.results.coordinates) == {"1", "01"}
    assert len(measures.by_run(tables)) == 4


def test_what_was_written_with_seven_digits_goes_on_under_the_same_name(tmp_path):
    settings = study_settings((1 / 3, 1.0), seeds=(4, 7))
    folder = write_study(tmp_path / "study", settings, lambda run, progress: 0.5)
    as_version_0_1(folder)
    for name in (*StudyDirectory.TABLES, "configurations"):
        path = folder / f"{name}.csv"
        text = path.read_text()
        assert ",0.3333333333333333,4," in text
        path.write_text(text.replace(",0.3333333333333333,4,", ",0.3333333,4,"))  # the first seed's run
    tables = read_study(folder)
    assert set(tables.results.condition) == {"pec, α = 0.3333333333333333", "pec, α = 1", "uniform"}
    assert measures.by_run(tables).groupby("condition").seed.nunique().eq(2).all()


def test_two_runs_of_one_name_are_refused_in_one_line(near_alphas, tmp_path):
    """A study written with seven digits of α may hold two that read alike."""
    settings = study_settings((0.2, 0.25), seeds=(4,))
    folder = write_study(tmp_path / "study", settings, lambda run, progress: progress)
    as_version_0_1(folder)
    for name in (*StudyDirectory.TABLES, "configurations"):
        path = folder / f"{name}.csv"
        path.write_text(path.read_text().replace("pec,0.25,", "pec,0.2,"))
    with pytest.raises(pecjax.InputError, match=r"results\.csv: .* pec, α = 0\.2, seed 4 .* twice") as error:
        read_study(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda arrays: arrays.pop("failures"), r"0001: not the arrays of a batch \(KeyError\('failures'"),
        (
            lambda arrays: arrays.update(iteration=np.arange(3)),
            r"0001: not the arrays of a batch \(ValueError",
        ),
        (lambda arrays: arrays.update(trials=arrays["trials"][0]), "0001: not the arrays of a batch"),
        (
            lambda arrays: arrays.update(goal_ratio=np.full((1, 8, 20), "x")),
            "0001: not the arrays of a batch",
        ),
        (None, "uniform, seed 0 it has results and no configurations; the command that"),
    ],
)
def test_batches_that_do_not_belong_to_the_tables_get_one_line(damage, words, tmp_path):
    folder = write_study(tmp_path / "study", study_settings(seeds=(0,)), lambda run, progress: progress)
    path = folder / "batches" / "0001" / "configurations.npz"
    if damage is None:
        shutil.rmtree(path.parent)
    else:
        arrays = dict(np.load(path))
        damage(arrays)
        np.savez(path, **arrays)
    with pytest.raises(pecjax.InputError, match=words) as error:
        study_report.write_report(folder)
    assert "\n" not in str(error.value)
    shutil.rmtree(folder / "batches")
    with pytest.raises(pecjax.InputError, match="none is there; resume the study"):
        read_study(folder)


def test_the_worst_tenth_of_an_evaluation_is_of_what_it_flew():
    reached = np.random.default_rng(0).random(20) < 0.7
    # 20 episodes for 200 configurations: the 20 that are flown have their worst two.
    flights = EvalResult(np.arange(20) * 7, reached, 1.0 * reached, np.ones(20), {})
    collected = Collected([{"seed": 4}])
    collected.rows("evaluation", [evaluation_row(1, 100, flights, EvalSet(np.zeros(200)))])
    (row,) = collected.table("evaluation")
    assert row["cvar"] == np.sort(reached)[:2].mean() == 0
    assert row["goal_ratio"] == reached.mean() and row["seed"] == 4


def test_a_study_of_version_0_1_is_reported_and_drawn_alike_but_not_gone_on_with(tmp_path, monkeypatch):
    # One seed: intervals, of which there are none then, are most of the time.
    settings = study_settings((0.2, 1 / 3), seeds=(4,), coordinates=("1", "2"))
    ends = {"1": 0.9, "2": 0.5}
    folder = write_study(tmp_path / "study", settings, lambda run, progress: ends[run.task.table] * progress)
    drawn = []
    monkeypatch.setattr(study_figures, "save", lambda figure, path: drawn.append(path.name) or [path])

    def report():
        drawn.clear()
        words = study_report.write_report(folder)
        study_figures.draw_study(folder)
        written = [(folder / f"{name}.csv").read_bytes() for name in ("runs", "summary", "paired")]
        return words, written, tuple(drawn)

    wanted, tables = report(), read_study(folder)
    as_version_0_1(folder)
    assert report() == wanted
    keys = ["coordinates", "condition", "seed", "iteration", "config"]
    found, configurations = (
        table.sort_values(keys, ignore_index=True)
        for table in (read_study(folder).configurations, tables.configurations)
    )
    pd.testing.assert_frame_equal(found[configurations.columns], configurations)
    with pytest.raises(pecjax.InputError, match=r"pecjax \('0\.1\.0' there") as error:
        run_study(StudyDirectory(folder).settings(), folder)
    assert "\n" not in str(error.value) and "give another folder with --out" in str(error.value)
    assert not (folder / "task-0").exists()


def test_groups_of_a_held_out_part_are_reported_paired_and_drawn(tmp_path, monkeypatch):
    """Easy ones go half as well as all, hard ones under PEC a tenth better than under uniform sampling."""
    settings = study_settings(seeds=(0, 1, 2))
    write_study(tmp_path / "study", settings, lambda run, progress: 0.2 * progress + 0.1 * run.seed)
    tables = read_study(tmp_path / "study")
    ratios, is_pec = tables.results.goal_ratio, tables.results.sampler == "pec"
    results = tables.results.assign(
        **{"goal_ratio.easy": ratios / 2, "goal_ratio.hard": ratios + 0.1 * is_pec}
    )
    known = tables.configurations.assign(goal_ratio=np.nan)  # held out: none of those trained in was flown
    tables = tables._replace(results=results, configurations=known)
    monkeypatch.setattr(study_report, "read_study", lambda folder: tables)
    study_report.write_report(tmp_path / "study")
    summary = pd.read_csv(tmp_path / "study/summary.csv").set_index("condition")
    np.testing.assert_allclose(summary["goal_ratio.easy"], summary.goal_ratio / 2)
    easy = summary.loc[["pec, α = 0.2", "uniform"], "goal_ratio.easy"]
    (row,) = [
        line.split(" | ")
        for line in (tmp_path / "study/report.md").read_text().partition("In pairs")[0].splitlines()
        if line.startswith("| easy at the end")
    ]
    assert [cell.partition(" [")[0] for cell in row[1:]] == [f"{ratio:.3f}" for ratio in easy]
    table = pd.read_csv(tmp_path / "study/paired.csv").set_index("measure")
    np.testing.assert_allclose(table.difference[["goal_ratio", "goal_ratio.easy"]], 0, atol=1e-12)
    hard = table.loc["goal_ratio.hard"]
    np.testing.assert_allclose(
        hard[["difference", "difference_low", "better", "pairs"]].astype(float), [0.1, 0.1, 3, 3]
    )
    figures = {}
    monkeypatch.setattr(study_figures, "read_study", lambda folder: tables)
    monkeypatch.setattr(
        study_figures, "save", lambda figure, path: figures.update({path.name: figure}) or [path]
    )
    study_figures.draw_study(tmp_path / "study")
    titles = [axes.get_title("left") for axes in figures["groups"].axes]
    assert "map" not in figures and titles == ["(a) easy", "(b) hard"]
    for axes, name in zip(figures["groups"].axes, ("easy", "hard"), strict=True):
        for line, sampler in zip(axes.lines, ("pec", "uniform"), strict=True):
            by_iteration = results[results.sampler == sampler].groupby("iteration")
            np.testing.assert_allclose(line.get_ydata(), by_iteration[f"goal_ratio.{name}"].mean())
    figure = study_curves.groups(results.assign(other=ratios), ["goal_ratio.easy"] * 4 + ["other"])
    assert len(figure.axes) == 5


@pytest.mark.parametrize(
    ("task", "name", "shown"),
    [
        ({"table": "2"}, "2", "set 2"),
        ({"table": "far/pairs.csv"}, "far/pairs.csv", "pairs"),
        ({"space": "rooms-storm"}, "rooms-storm", "rooms-storm"),
    ],
)
def test_a_study_names_the_space_of_its_runs(task, name, shown):
    run = study_settings().run
    assert space_name(replace(run, task=replace(run.task, **task))) == name
    assert shown_space(name) == shown
