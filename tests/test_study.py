"""Studies: what a grid is cut into, that its runs are true ones, and that stopping loses nothing."""

import hashlib
import json
import os
import resource
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pecjax
from pecjax.commands.study import Study
from pecjax.curriculum import PEC
from pecjax.errors import DivergedError, StoppedError
from pecjax.plotting import study as study_figures
from pecjax.runtime import provenance
from pecjax.storage.files import alone
from pecjax.studies import directory as study_directory, report as study_report
from pecjax.studies.catalogue import SCALES, STUDIES, find_study
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import RunSpec, StudySettings
from pecjax.studies.run import _Rows, run_study
from pecjax.training import train as training
from pecjax.training.build import make_agent
from pecjax.training.program import make_program
from pecjax.training.progress import Progress

SMOKE = find_study("fig4", "smoke").run
TINY = replace(SMOKE, ppo=replace(SMOKE.ppo, num_steps=64), iterations=3, evaluation_episodes=7)
TABLES = ("results", "metrics", "configurations")


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


@pytest.fixture(scope="module")
def near_goals(folders):
    """Three pairs so near that some episodes succeed."""
    path = folders / "near.csv"
    path.write_text("0 -2 0.7 -2\n5 -2.4 5 -3.2\n-5 -2 -5 -1.2\n")
    return str(path)


@pytest.fixture(scope="module")
def settings(near_goals):
    run = replace(TINY, coordinates=near_goals)
    return StudySettings("tiny", run, alphas=(0.0, 3.0), coordinates=(near_goals,), seeds=(4, 7))


@pytest.fixture(scope="module", autouse=True)
def programs_once():
    """Each program is compiled once for all tests: a run's settings and their number name it."""
    made = {}

    def make_once(run, scene, table, runs):
        if (run, runs) not in made:
            made[run, runs] = make_program(run, scene, table, runs)
        return made[run, runs]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("pecjax.studies.run.make_program", make_once)
        yield


@pytest.fixture(scope="module")
def study(folders, settings):
    run_study(settings, folders / "study")
    return folders / "study"


def digests(folder):
    return {name: hashlib.sha256((folder / f"{name}.csv").read_bytes()).hexdigest() for name in TABLES}


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("scale", SCALES)
def test_the_papers_studies_can_be_run_and_cover_their_grids(name, scale):
    study = find_study(name, scale)
    study.check()
    assert study.name == name
    flown = [member for part in study.slices() for member in part]
    assert len(flown) == len(set(flown)) == sum(map(len, study.groups()))
    for part in study.slices():
        assert 1 <= len(part) <= study.at_once
        assert len({(member.coordinates, member.sampler) for member in part}) == 1
    # Whatever is finished first can be paired: low seeds come first.
    firsts = [part[0].seed for part in study.slices()]
    assert firsts == sorted(firsts)


def test_the_grid_of_each_of_the_papers_studies():
    fig4, fig8 = find_study("fig4"), find_study("fig8")
    assert set(fig4.samplers) == set(fig8.samplers) == {"pec", "uniform"}
    assert (fig4.coordinates, fig8.coordinates) == (("1",), ("2",))
    assert len(fig4.seeds) >= 10 and len(fig8.seeds) >= 10
    fig11 = find_study("fig11")
    assert fig11.alphas == (0.0, 0.1, 0.2, 0.3, 0.4) and len(fig11.groups()[0]) == 25
    assert find_study("fig14").run.algorithm == "apex" and len(find_study("fig14").seeds) >= 5
    paper = {name: find_study(name, "paper").run for name in STUDIES}
    assert [run.iterations for run in paper.values()] == [1500, 5000, 1500, 2000]
    assert [run.preset for run in paper.values()] == ["rllib085"] * 3 + ["apex-rllib085"]


def test_alpha_is_of_samplers_that_have_one(settings):
    groups = settings.groups()
    assert [member.alpha for member in groups[0]] == [0.0, 3.0, 0.0, 3.0]
    assert [member.alpha for member in groups[1]] == [None, None]
    assert settings.settings_of(RunSpec("2", "pec", 3.0, 7)) == replace(
        settings.run, coordinates="2", sampler=PEC(3.0), seed=7
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seeds": ()}, "seeds is empty"),
        ({"alphas": ()}, "alphas is empty"),
        ({"samplers": ("bandit",)}, "unknown sampler 'bandit'"),
        ({"alphas": (0.1, -1.0)}, "alpha is -1"),
        ({"seeds": (3, 1, 3)}, "seeds names 3 more than once"),
        ({"seeds": (-3,)}, "seed is -3"),
        ({"at_once": 0}, "at-once is 0"),
        ({"run": replace(TINY, until_goal_ratio=0.9)}, "until-goal-ratio"),
    ],
)
def test_grids_that_cannot_be_run(changes, words, settings, tmp_path):
    with pytest.raises(pecjax.InputError, match=words):
        run_study(replace(settings, **changes), tmp_path / "study")
    assert not (tmp_path / "study").exists()


def test_its_tables_have_a_row_for_everything(study, settings):
    results, metrics, configurations = (pd.read_csv(study / f"{name}.csv") for name in TABLES)
    assert len(metrics) == 6 * 3 and len(results) == 6 * 2 and len(configurations) == 6 * 2 * 3
    assert list(results.columns[:7]) == list(metrics.columns[:7])
    assert list(results.columns[7:]) == [
        "goal_ratio",
        "training_goal_ratio",
        "cvar",
        "mean_return",
        "c0",
        "c1",
        "c2",
    ]
    assert sorted(set(results.iteration)) == [2, 3] and (results.env_steps == results.iteration * 512).all()
    runs = metrics.fillna({"alpha": -1}).groupby(["sampler", "alpha", "seed"])
    assert sorted(runs.groups) == sorted(
        [("pec", a, s) for a in (0.0, 3.0) for s in (4, 7)] + [("uniform", -1, 4), ("uniform", -1, 7)]
    )
    for _, run in runs:
        assert run.iteration.tolist() == [1, 2, 3]
    worst = results[["c0", "c1", "c2"]].min(axis=1)
    np.testing.assert_allclose(results.cvar, worst, rtol=1e-6)
    ended = configurations[configurations.iteration == 3].groupby(["sampler", "seed"]).trials.sum()
    np.testing.assert_array_equal(ended, metrics.groupby(["sampler", "seed"]).episodes.sum())


def test_a_study_of_the_first_version_goes_on(study, settings, tmp_path):
    """It named samplers by words, had an α of all runs, and no further grid."""
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    content = json.loads((folder / "study.json").read_text())
    content["settings"]["run"] |= {"sampler": "pec", "alpha": 0.2}
    del content["settings"]["grid"]
    (folder / "study.json").write_text(json.dumps(content))
    assert StudyDirectory(folder).settings() == settings
    run_study(settings, folder)
    assert digests(folder) == digests(study)
    with pytest.raises(
        pecjax.InputError, match=r"differs in grid \(\[\] there, \[\['ppo.clip', \[0.1\]\]\] here"
    ):
        run_study(replace(settings, grid=(("ppo.clip", (0.1,)),)), folder)


@pytest.mark.slow
@pytest.mark.parametrize(("sampler", "alpha", "seed"), [("pec", 3.0, 7), ("uniform", None, 4)])
def test_a_run_of_a_study_is_the_run_that_train_would_make(sampler, alpha, seed, study, settings, folders):
    alone = settings.settings_of(RunSpec(settings.run.coordinates, sampler, alpha, seed))
    folder = folders / f"alone-{sampler}"
    training.train(alone, folder, devices=1)
    for name, table in (("metrics", "metrics"), ("results", "evaluation"), ("configurations",) * 2):
        rows = pd.read_csv(study / f"{name}.csv").fillna({"alpha": -1})
        rows = rows[(rows.sampler == sampler) & (rows.alpha == (alpha or -1)) & (rows.seed == seed)]
        wanted = pd.read_csv(folder / f"{table}.csv")
        rows, wanted = (
            rows[rows.iteration.isin(wanted.iteration)],
            wanted[wanted.iteration.isin(rows.iteration)],
        )
        both = [column for column in rows.columns if column in wanted.columns]
        assert len(both) >= 4 and rows.iteration.iloc[-1] == 3
        np.testing.assert_allclose(rows[both], wanted[both], rtol=1e-5, err_msg=name)


def test_the_same_seed_begins_alike_under_every_sampler(study):
    first = pd.read_csv(study / "metrics.csv").query("iteration == 1")
    for _, runs in first.groupby("seed"):
        assert len(runs) == 3
        assert (runs[["goal_ratio", "episodes", "mean_return"]].nunique() == 1).all()
    assert first.mean_return.nunique() == 2  # and differently under another seed


class KilledError(Exception):
    """Stands for whatever kills a study."""


@pytest.mark.parametrize("finished", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 2))])
def test_a_study_that_was_stopped_ends_byte_for_byte_the_same(
    finished, study, settings, tmp_path, monkeypatch, capsys
):
    folder = tmp_path / "study"
    write = StudyDirectory.write_slice

    def stop(self, number, *args):
        if number == finished:
            (self.folder / "slices" / f".{number:04}").mkdir()  # as a kill in the middle would leave it
            raise KilledError
        write(self, number, *args)

    monkeypatch.setattr(StudyDirectory, "write_slice", stop)
    with pytest.raises(KilledError):
        run_study(settings, folder)
    monkeypatch.setattr(StudyDirectory, "write_slice", write)
    there = sorted((folder / "slices").glob("0*/results.csv"))
    assert len(there) == finished
    before = [path.stat().st_mtime_ns for path in there]
    capsys.readouterr()
    run_study(settings, folder)
    assert f"{finished} of 3 slices are there" in capsys.readouterr().err
    assert digests(folder) == digests(study)
    assert [path.stat().st_mtime_ns for path in there] == before  # what was finished was not repeated


@pytest.mark.parametrize("asked", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_stops_a_study_between_evaluations(asked, study, settings, tmp_path, monkeypatch):
    advance = Progress.advance

    def interrupt(self, iterations, figures):
        os.kill(os.getpid(), asked)
        advance(self, iterations, figures)

    with monkeypatch.context() as patched:
        patched.setattr(Progress, "advance", interrupt)
        with pytest.raises(StoppedError, match="the same command keeps what is finished") as stop:
            run_study(settings, tmp_path / "study")
    assert stop.value.signal == asked
    run_study(settings, tmp_path / "study")
    assert digests(tmp_path / "study") == digests(study)


@pytest.mark.slow
def test_a_signal_at_the_end_of_a_slice_keeps_it_and_begins_no_other(settings, tmp_path, monkeypatch):
    write = StudyDirectory.write_slice

    def interrupt(self, number, *args):
        os.kill(os.getpid(), signal.SIGINT)
        write(self, number, *args)

    monkeypatch.setattr(StudyDirectory, "write_slice", interrupt)
    with pytest.raises(StoppedError):
        run_study(settings, tmp_path / "study")
    assert [path.name for path in (tmp_path / "study" / "slices").iterdir()] == ["0000"]
    assert len(pd.read_csv(tmp_path / "study" / "results.csv")) == 2 * 2


@pytest.mark.slow
def test_a_full_disk_is_said_and_the_study_goes_on_afterwards(study, settings, tmp_path):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    shutil.rmtree(folder / "slices" / "0001")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))  # no file may grow beyond it
    try:
        with pytest.raises(pecjax.InputError, match=r"cannot be written .* goes on"):
            run_study(settings, folder)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    run_study(settings, folder)
    assert digests(folder) == digests(study)


@pytest.mark.slow
def test_a_study_whose_runs_all_diverge_ends_with_one_line_and_does_not_repeat_them(
    settings, tmp_path, monkeypatch, capsys
):
    run = replace(settings.run, ppo=replace(settings.run.ppo, learning_rate=1e30))
    diverging = replace(settings, run=run, samplers=("pec",), seeds=(4,))
    words = (
        r"2 of 2 runs diverged .* sampler pec, alpha 0\.0, seed 4: at iteration \d .*parameters.*try again"
    )
    with pytest.raises(DivergedError, match=words) as error:
        run_study(diverging, tmp_path / "study")
    assert "\n" not in str(error.value)
    assert capsys.readouterr().err.count("; the other runs continue") == 2
    assert not StudyDirectory(tmp_path / "study").has_rows()
    monkeypatch.setattr("pecjax.studies.run.make_program", None)
    with pytest.raises(DivergedError, match=words):
        run_study(diverging, tmp_path / "study")


def test_a_run_that_diverges_is_left_out_and_all_others_are_made(
    study, settings, tmp_path, monkeypatch, capsys
):
    """As if PEC with α = 3 and seed 4 diverged: the second run of the first slice."""
    folder, add, asked = tmp_path / "study", _Rows.add_metrics, []

    def add_metrics(self, iteration, metrics):
        member = self._head["alpha"], self._head["seed"]
        if member == ("3", 4) and iteration == 2:
            asked.append(member)
            metrics = metrics._replace(finite=dict.fromkeys(metrics.finite, False))
        add(self, iteration, metrics)

    monkeypatch.setattr(_Rows, "add_metrics", add_metrics)
    for _ in range(2):
        with pytest.raises(DivergedError, match=r"1 of 6 runs .* alpha 3\.0, seed 4: at iteration 2"):
            run_study(settings, folder)
    assert len(asked) == 1  # the second time nothing is trained
    for name in TABLES:
        wanted = pd.read_csv(study / f"{name}.csv")
        wanted = wanted[~((wanted.alpha == 3) & (wanted.seed == 4))].reset_index(drop=True)
        pd.testing.assert_frame_equal(pd.read_csv(folder / f"{name}.csv"), wanted)
    assert "pec, α = 3 - uniform, 1 pairs" in study_report.write_report(folder)
    # The command reports what there is before it ends with the same line.
    named = Study(name="fig4", scale="smoke", out=folder)
    monkeypatch.setattr(Study, "_settings", lambda *_: settings)
    monkeypatch.setattr("pecjax.commands.study.draw", lambda _: [])
    capsys.readouterr()
    with pytest.raises(DivergedError, match="1 of 6 runs"):
        named.run()
    out, err = capsys.readouterr()
    assert "1 pairs" in out and "smoke" not in out.replace(str(folder), "")
    assert err.count("a smoke study tries the program out; its runs are too short to learn") == 2
    assert err.splitlines()[0].endswith("anything")
    shutil.rmtree(folder / "slices" / "0000")
    monkeypatch.setattr(_Rows, "add_metrics", add)
    run_study(settings, folder)
    assert digests(folder) == digests(study)


def test_a_finished_study_only_gathers(study, settings, monkeypatch):
    monkeypatch.setattr("pecjax.studies.run.make_program", None)
    before = digests(study)
    (study / "results.csv").unlink()
    run_study(settings, study)
    assert digests(study) == before


@pytest.mark.parametrize(
    "damage",
    [
        "a changed figure",
        *(
            pytest.param(damage, marks=pytest.mark.slow)
            for damage in ("cut short", "a lost table", "no checksums")
        ),
    ],
)
def test_a_damaged_slice_is_found_said_and_made_again(damage, study, settings, tmp_path, capsys):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    path = folder / "slices" / "0001" / "results.csv"
    text = path.read_text()
    if damage == "a changed figure":
        path.write_text(text.replace("1024", "1023", 1))
    elif damage == "cut short":
        path.write_text(text[: len(text) // 2])
    elif damage == "a lost table":
        path.unlink()
    else:
        (path.parent / "SHA256SUMS").write_text("")
    run_study(settings, folder)
    err = capsys.readouterr().err
    assert "0001: not as it was written; made again" in err and "2 of 3 slices are there" in err
    assert digests(folder) == digests(study)


def test_another_studys_folder_is_refused_and_the_difference_named(study, settings, monkeypatch, near_goals):
    before = digests(study)

    def refusal(**changes):
        with pytest.raises(pecjax.InputError) as error:
            run_study(replace(settings, **changes), study)
        assert digests(study) == before
        return str(error.value)

    assert "seeds ([4, 7] there, [4] here)" in refusal(seeds=(4,))
    assert "run.ppo.learning_rate (0.0003 there, 0.001 here)" in refusal(
        run=replace(settings.run, ppo=replace(settings.run.ppo, learning_rate=1e-3))
    )
    versions = study_directory.environment_facts(1)
    versions["versions"]["jax"] = "0.1"
    monkeypatch.setattr(study_directory, "environment_facts", lambda _: versions)
    assert "jax" in refusal()
    monkeypatch.undo()
    with open(near_goals, "a") as file:
        file.write("0 0 1 0\n")
    assert "the content of coordinates-near.csv" in refusal()
    with open(near_goals, "w") as file:
        file.write("0 -2 0.7 -2\n5 -2.4 5 -3.2\n-5 -2 -5 -1.2\n")


def commits(folder):
    texts = [path.read_text() for path in sorted((folder / "slices").glob("*/provenance.json"))]
    return [json.loads(text)["git_commit"] for text in texts]


def test_a_study_that_goes_on_at_another_commit_says_so_and_keeps_both(study, settings, tmp_path, capsys):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    began = json.loads((study / "study.json").read_text())
    shutil.rmtree(folder / "slices" / "0001")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(provenance, "git_commit", lambda: "f00df00d-dirty")
        run_study(settings, folder)
    commit = began["git_commit"]
    assert commits(folder) == [commit, "f00df00d-dirty", commit] and commits(study) == [commit] * 3
    if commit:  # the tests may run outside a checkout
        words = f"begun at commit {provenance.short_commit(commit)} and goes on at f00df00-dirty"
        assert words in capsys.readouterr().err
    assert digests(folder) == digests(study)
    assert (folder / "study.json").read_bytes() == (study / "study.json").read_bytes()


def test_slices_of_an_older_version_need_no_provenance(study, settings, tmp_path, monkeypatch):
    monkeypatch.setattr("pecjax.studies.run.make_program", None)
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    for path in (folder / "slices").glob("*/SHA256SUMS"):
        (path.parent / "provenance.json").unlink()
        path.write_text("".join(line for line in path.read_text().splitlines(True) if ".csv" in line))
    run_study(settings, folder)
    assert digests(folder) == digests(study)


def test_a_slice_with_an_empty_table_is_no_traceback(study, settings, tmp_path, monkeypatch):
    monkeypatch.setattr("pecjax.studies.run.make_program", None)
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    path = folder / "slices" / "0001" / "metrics.csv"
    sums = path.with_name("SHA256SUMS")
    empty = hashlib.sha256(b"").hexdigest()
    sums.write_text(sums.read_text().replace(hashlib.sha256(path.read_bytes()).hexdigest(), empty))
    path.write_bytes(b"")
    run_study(settings, folder)
    assert len(pd.read_csv(folder / "metrics.csv")) == 4 * 3


def test_a_study_that_begins_while_another_looks_at_the_folder_is_left_alone(settings, tmp_path, monkeypatch):
    folder, free = tmp_path / "study", study_directory.plain_files.check_free

    def look(path):
        free(path)
        monkeypatch.setattr(study_directory.plain_files, "check_free", free)
        with monkeypatch.context() as patched:
            patched.setattr("pecjax.studies.run._make_slices", lambda *_: None)
            run_study(replace(settings, seeds=(9,)), folder)

    monkeypatch.setattr(study_directory.plain_files, "check_free", look)
    with pytest.raises(pecjax.InputError, match=r"differs in settings.seeds|differs in seeds"):
        run_study(settings, folder)
    assert StudyDirectory(folder).settings().seeds == (9,)
    with alone(folder), pytest.raises(pecjax.InputError, match="another process trains here"):
        run_study(settings, folder)


def test_what_else_lies_among_the_slices_is_left_alone(study, settings, tmp_path):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    shutil.copytree(folder / "slices" / "0001", folder / "slices" / "0001 copy")
    (folder / "slices" / ".DS_Store").write_text("")
    run_study(settings, folder)
    assert digests(folder) == digests(study)
    assert (folder / "slices" / ".DS_Store").exists()


@pytest.mark.slow
def test_a_study_killed_while_its_folder_is_made_begins_again(study, settings, tmp_path, monkeypatch):
    def kill(*_):
        raise KilledError

    place = tmp_path / "here"
    place.mkdir()
    monkeypatch.chdir(place)  # a folder that is there and empty will do
    with monkeypatch.context() as patched:
        patched.setattr(study_directory, "table_text", lambda table: table.no_such_thing)
        with pytest.raises(AttributeError):
            run_study(settings, Path("."))
    assert not list(place.iterdir())
    with monkeypatch.context() as patched:
        patched.setattr(study_directory.os, "replace", kill)
        with pytest.raises(KilledError):
            run_study(settings, Path("."))
    assert not (place / "study.json").exists() and (place / "scene.xml").exists()
    run_study(settings, Path("."))
    assert digests(place) == digests(study)


def test_a_study_knows_what_its_replays_take(monkeypatch):
    apex = find_study("fig14", "smoke").run
    scene = pecjax.load_scene()
    asked = []
    monkeypatch.setattr("pecjax.training.program.check_memory", lambda needed, devices: asked.append(needed))
    for runs in (1, 4):
        make_program(apex, scene, pecjax.COORDINATE_SET_1, runs)
    agent = make_agent(
        apex, pecjax.RoomsNavigation(scene), pecjax.COORDINATE_SET_1, pecjax.curriculum.pec(20)
    )
    assert asked == [agent.replay_bytes, 4 * agent.replay_bytes]


def test_the_folder_of_a_run_is_no_place_for_a_study(settings, tmp_path):
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(pecjax.InputError, match="holds another run"):
        run_study(settings, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]


def test_the_report_is_of_the_tables(study):
    words = study_report.write_report(study)
    assert len(words.splitlines()) == 3 + 2  # conditions, and those compared with uniform
    assert "pec, α = 3 - uniform, 2 pairs: goal ratio" in words
    results = pd.read_csv(study / "results.csv").query("iteration == 3")
    summary = pd.read_csv(study / "summary.csv").set_index("condition")
    assert list(summary.index) == ["pec, α = 0", "pec, α = 3", "uniform"]
    uniform = results[results.sampler == "uniform"]
    assert summary.goal_ratio["uniform"] == pytest.approx(uniform.goal_ratio.mean())
    assert summary.seeds.tolist() == [2, 2, 2]
    paired = pd.read_csv(study / "paired.csv").set_index(["condition", "measure"])
    pec = results[results.alpha == 3].set_index("seed").goal_ratio
    found = paired.loc[("pec, α = 3", "goal_ratio")]
    difference = pec - uniform.set_index("seed").goal_ratio
    assert found.difference == pytest.approx(difference.mean(), abs=1e-6)
    assert found.better == (difference > 0).sum() and found.worse == (difference < 0).sum()
    assert found.p in (0.5, 1.0)  # all that two pairs can have
    # Nothing this short holds a threshold: no figure is made up for it.
    never = paired.loc[("pec, α = 3", "steps_until_0.95")]
    assert never.pairs == 0 and np.isnan(never.difference) and np.isnan(never.p)


def test_what_the_report_says_of_training_is_of_the_tables(study):
    study_report.write_report(study)
    runs = pd.read_csv(study / "runs.csv").set_index(["condition", "seed"])
    metrics, configurations = (pd.read_csv(study / f"{name}.csv") for name in TABLES[1:])
    mine = (metrics.alpha == 3) & (metrics.seed == 7)
    run = runs.loc[("pec, α = 3", 7)]
    assert run.training_goal_ratio == pytest.approx(metrics[mine].goal_ratio.mean(), rel=1e-5)
    counts = configurations.query("alpha == 3 and seed == 7 and iteration == 3")
    trial = counts.trials / counts.trials.sum()
    assert (run.least_trial_ratio, run.greatest_trial_ratio) == pytest.approx((trial.min(), trial.max()))
    assert run.failure_ratio == pytest.approx((counts.failures / counts.trials).mean(), rel=1e-5)
    assert np.isnan(runs.alpha[("uniform", 4)]) and run.alpha == 3


def test_every_figure_of_a_study_is_drawn(study):
    paths = study_figures.draw_study(study)
    names = {path.stem for path in paths}
    assert names == {
        *("goal_ratio", "evaluation", "spread", "exit", "steps_to_threshold", "map", "alpha"),
        *("configurations-pec-0", "configurations-pec-3", "configurations-uniform"),
    }
    assert {path.suffix for path in paths} == {".png", ".svg"} and all(path.is_file() for path in paths)
