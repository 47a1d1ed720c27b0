"""Studies: what a grid is cut into, that its runs are true ones, and that stopping loses nothing."""

import hashlib
import json
import os
import resource
import shutil
import signal
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pecjax
from pecjax.commands.study import Study
from pecjax.curriculum import PEC, pec
from pecjax.errors import DivergedError, StoppedError
from pecjax.plotting import study as study_figures
from pecjax.runtime import provenance
from pecjax.storage.files import alone
from pecjax.studies import directory as study_directory, report as study_report, run as study_run
from pecjax.studies.catalogue import STUDIES, find_study
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import RunSpec, StudySettings, fixed
from pecjax.studies.run import run_study
from pecjax.training import train as training
from pecjax.training.build import observation_bytes
from pecjax.training.evaluation import stratified_config_ids
from pecjax.training.program import several_runs
from pecjax.training.run_directory import RunDirectory
from pecjax.training.settings import StopSettings, override
from pecjax.training.sinks import Progress

SMOKE = find_study("fig4", "smoke").run
TINY = replace(
    SMOKE,
    agent=replace(SMOKE.agent, num_steps=64),
    stop=StopSettings(iterations=3),
    evaluation=replace(SMOKE.evaluation, episodes=7),
)
TABLES = ("results", "metrics")


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


@pytest.fixture(scope="module")
def near_goals(folders):
    """Three pairs so near that some episodes succeed."""
    path = folders / "near.csv"
    path.write_text("0 -2 0.7 -2\n5 -2.4 5 -3.2\n-5 -2 -5 -1.2\n")
    return str(path)


def grid_of(coordinates, samplers=("pec", "uniform"), alphas=(0.0, 3.0)):
    return (("task.table", (coordinates,)), ("sampler", samplers), ("sampler.alpha", alphas))


@pytest.fixture(scope="module")
def settings(near_goals):
    run = override(TINY, coordinates=near_goals)
    return StudySettings("tiny", run, grid_of(near_goals), seeds=(4, 7))


@pytest.fixture(scope="module", autouse=True)
def programs_once():
    """Each program is compiled once for all tests: a run's settings and their number name it."""
    made = {}

    def make_once(run, task, world, runs):
        if (run, runs) not in made:
            made[run, runs] = several_runs(run, task, world, runs)
        return made[run, runs]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(study_run, "several_runs", make_once)
        yield


@pytest.fixture(scope="module")
def study(folders, settings):
    run_study(settings, folders / "study")
    return folders / "study"


def counted(folder):
    """The arrays of all configurations, batch by batch."""
    paths = sorted(folder.glob("batches/[0-9][0-9][0-9][0-9]/configurations.npz"))
    return [dict(np.load(path)) for path in paths]


def digests(folder):
    tables = [folder / f"{name}.csv" for name in TABLES]
    arrays = sorted(folder.glob("batches/[0-9][0-9][0-9][0-9]/configurations.npz"))
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in (*tables, *arrays)
    }


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("scale", ("smoke", "laptop", "paper"))
def test_the_papers_studies_can_be_run_and_cover_their_grids(name, scale):
    study = find_study(name, scale)
    study.check()
    assert study.name == name
    flown = [member for part in study.batches() for member in part]
    assert len(flown) == len(set(flown)) == sum(map(len, study.groups()))
    for part in study.batches():
        assert 1 <= len(part) <= study.parallel_runs
        assert len({fixed(member.values) for member in part}) == 1
    # Whatever is finished first can be paired: low seeds come first.
    firsts = [part[0].seed for part in study.batches()]
    assert firsts == sorted(firsts)


def test_the_grid_of_each_of_the_papers_studies():
    fig4, fig8 = find_study("fig4"), find_study("fig8")
    for study, coordinates in ((fig4, "1"), (fig8, "2")):
        assert set(study.values_of("sampler")) == {"pec", "uniform"} and len(study.seeds) >= 10
        assert study.values_of("task.table") == (coordinates,)
    fig11 = find_study("fig11")
    assert fig11.values_of("sampler.alpha") == (0.0, 0.1, 0.2, 0.3, 0.4) and len(fig11.groups()[0]) == 25
    fig14 = find_study("fig14")
    assert isinstance(fig14.run.agent, pecjax.agents.Apex) and len(fig14.seeds) >= 5
    paper = {name: find_study(name, "paper").run for name in STUDIES}
    assert [run.stop.iterations for run in paper.values()] == [1500, 5000, 1500, 2000]
    assert [run.preset for run in paper.values()] == ["rllib085"] * 3 + ["apex-rllib085"]


def test_alpha_is_of_samplers_that_have_one(settings):
    groups = settings.groups()
    assert [dict(member.values)["sampler.alpha"] for member in groups[0]] == [0.0, 3.0, 0.0, 3.0]
    assert ["sampler.alpha" in dict(member.values) for member in groups[1]] == [False, False]
    values = (("task.table", "2"), ("sampler", "pec"), ("sampler.alpha", 3.0))
    assert settings.settings_of(RunSpec(7, values)) == replace(
        settings.run, task=replace(settings.run.task, table="2"), sampler=PEC(3.0), seed=7
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seeds": ()}, "seeds is empty"),
        ({"grid": grid_of("1", alphas=())}, "alphas is empty"),
        ({"grid": grid_of("1", samplers=("bandit",))}, "unknown sampler 'bandit'"),
        ({"grid": grid_of("1", alphas=(0.1, -1.0))}, "alpha is -1"),
        ({"grid": (("task.table", ("1", "1")),)}, "coordinates names 1 more than once"),
        ({"grid": (("task.table", ("a/x.csv", "b/x.csv")),)}, "x.csv, b/x.csv need names that differ"),
        ({"grid": (("stop.iterations", (3, 4)),)}, "stop.iterations is not of task, sampler or agent"),
        ({"grid": grid_of("1", samplers=("uniform",))}, "none of uniform has sampler.alpha"),
        ({"seeds": (3, 1, 3)}, "seeds names 3 more than once"),
        ({"seeds": (-3,)}, "seed is -3"),
        ({"parallel_runs": 0}, "parallel-runs is 0"),
        ({"run": override(TINY, until_goal_ratio=0.9)}, "until-goal-ratio"),
    ],
)
def test_grids_that_cannot_be_run(changes, words, settings, tmp_path):
    with pytest.raises(pecjax.InputError, match=words):
        run_study(replace(settings, **changes), tmp_path / "study")
    assert not (tmp_path / "study").exists()


def test_its_tables_have_a_row_for_everything(study, settings):
    results, metrics = (pd.read_csv(study / f"{name}.csv") for name in TABLES)
    assert len(metrics) == 6 * 3 and len(results) == 6 * 2
    assert list(results.columns[:7]) == list(metrics.columns[:7])
    assert list(results.columns[7:]) == [
        "goal_ratio",
        "cvar",
        "mean_return",
        "mean_length",
        "collision",
        "path_length",
        "timeout",
        "unstable",
        "training_goal_ratio",
        "unbiased_cvar",
    ]
    assert sorted(set(results.iteration)) == [2, 3] and (results.env_steps == results.iteration * 512).all()
    runs = metrics.fillna({"alpha": -1}).groupby(["sampler", "alpha", "seed"])
    assert sorted(runs.groups) == sorted(
        [("pec", a, s) for a in (0.0, 3.0) for s in (4, 7)] + [("uniform", -1, 4), ("uniform", -1, 7)]
    )
    for _, run in runs:
        assert run.iteration.tolist() == [1, 2, 3]
    # Of every configuration: what was flown in training, and how its episodes of the evaluation ended.
    arrays = counted(study)
    assert [part["iteration"].tolist() for part in arrays] == [[2, 3]] * 3
    trials, failures, ratios = (
        np.concatenate([part[name] for part in arrays]) for name in ("trials", "failures", "goal_ratio")
    )
    assert trials.shape == failures.shape == ratios.shape == (6, 2, 3)
    assert (failures <= trials).all() and (trials[:, 0] <= trials[:, 1]).all()
    np.testing.assert_allclose(results.cvar, ratios.min(axis=-1).ravel(), rtol=1e-6)
    flown = np.bincount(stratified_config_ids(3, 7, settings.run.evaluation.seed))
    np.testing.assert_allclose(results.goal_ratio, (ratios @ flown).ravel() / 7, rtol=1e-6)
    episodes = metrics.episodes.to_numpy().reshape(6, 3).cumsum(axis=1)
    np.testing.assert_array_equal(trials.sum(axis=-1), episodes[:, 1:])
    ended = metrics.goal_ratio.fillna(0) * metrics.episodes
    successes = ended.to_numpy().reshape(6, 3).cumsum(axis=1)
    np.testing.assert_allclose((trials - failures).sum(axis=-1), successes[:, 1:], atol=1e-3)


def test_a_study_of_the_first_version_is_read_and_not_resumed(study, settings, tmp_path):
    """It named samplers by words, had an α of all runs, and no further grid."""
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    content = json.loads((folder / "study.json").read_text())
    (table,) = settings.values_of("task.table")
    ppo = {"num_envs": 8, "num_steps": 64, "num_minibatches": 2, "network": {"hidden": [8]}}
    run = {"algorithm": "ppo", "ppo": ppo, "apex": {}, "sampler": "pec", "alpha": 0.2, "coordinates": table}
    run |= {"scene": None, "iterations": 3, "evaluate_every": 2, "evaluation_episodes": 7}
    grid = {"samplers": ["pec", "uniform"], "alphas": [0.0, 3.0], "coordinates": [table]}
    content["settings"] = {"name": "tiny", "seeds": [4, 7], "at_once": 2, "run": run} | grid
    content["versions"]["pecjax"] = "0.1.0"
    (folder / "study.json").write_text(json.dumps(content))
    network = replace(settings.run.agent.network, critic="observation", precision="float32")
    former = replace(settings, run=replace(settings.run, agent=replace(settings.run.agent, network=network)))
    assert StudyDirectory(folder).settings() == former
    with pytest.raises(pecjax.InputError, match=r"differs in pecjax \('0\.1\.0' there, '.*' here\); give an"):
        run_study(former, folder)
    assert digests(folder) == digests(study)


@pytest.mark.slow
@pytest.mark.parametrize(("sampler", "alpha", "seed"), [("pec", 3.0, 7), ("uniform", None, 4)])
def test_a_run_of_a_study_is_the_run_that_train_would_make(sampler, alpha, seed, study, settings, folders):
    values = (("sampler", sampler), *([("sampler.alpha", alpha)] if alpha else []))
    alone = replace(settings.settings_of(RunSpec(seed, values)), configurations_every=2)
    folder = folders / f"alone-{sampler}"
    training.train(alone, folder, devices=1)
    for name, table in (("metrics", "metrics"), ("results", "evaluation")):
        rows = pd.read_csv(study / f"{name}.csv").fillna({"alpha": -1})
        rows = rows[(rows.sampler == sampler) & (rows.alpha == (alpha or -1)) & (rows.seed == seed)]
        wanted = pd.read_csv(folder / f"{table}.csv")
        assert rows.iteration.tolist() == wanted.iteration.tolist() and wanted.iteration.iloc[-1] == 3
        both = [column for column in rows.columns if column in wanted.columns]
        assert len(both) >= 8
        # Losses come out of differences of numbers about 1, in float32.
        np.testing.assert_allclose(rows[both], wanted[both], rtol=1e-5, atol=1e-7, err_msg=name)
    (part, run) = {"pec": (2, 1), "uniform": (1, 0)}[sampler]
    found = counted(study)[part]
    for place, iteration in enumerate(found["iteration"]):
        counts, flown = (RunDirectory(folder).arrays(f, iteration) for f in ("configurations", "episodes"))
        for name in ("trials", "failures", "steps"):
            np.testing.assert_array_equal(found[name][run, place], counts[name])
        ratios = [flown["success"][flown["config_id"] == config].mean() for config in range(3)]
        np.testing.assert_allclose(found["goal_ratio"][run, place], ratios)


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
    write = StudyDirectory.write_batch

    def stop(self, number, *args):
        if number == finished:
            (self.folder / "batches" / f".{number:04}").mkdir()  # as a kill in the middle would leave it
            raise KilledError
        write(self, number, *args)

    monkeypatch.setattr(StudyDirectory, "write_batch", stop)
    with pytest.raises(KilledError):
        run_study(settings, folder)
    monkeypatch.setattr(StudyDirectory, "write_batch", write)
    there = sorted((folder / "batches").glob("0*/results.csv"))
    assert len(there) == finished
    before = [path.stat().st_mtime_ns for path in there]
    capsys.readouterr()
    run_study(settings, folder)
    assert f"{finished} of 3 batches are there" in capsys.readouterr().err
    assert digests(folder) == digests(study)
    assert [path.stat().st_mtime_ns for path in there] == before  # what was finished was not repeated


@pytest.mark.parametrize("asked", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_stops_a_study_between_evaluations(asked, study, settings, tmp_path, monkeypatch):
    rows, told = Progress.rows, []

    def interrupt(self, table, of_runs):
        os.kill(os.getpid(), asked)
        told.append(of_runs[0]["iteration"])
        rows(self, table, of_runs)

    with monkeypatch.context() as patched:
        patched.setattr(Progress, "rows", interrupt)
        with pytest.raises(StoppedError, match="the same command keeps what is finished") as stop:
            run_study(settings, tmp_path / "study")
    assert stop.value.signal == asked and told == [1]
    assert not list((tmp_path / "study" / "batches").iterdir())
    run_study(settings, tmp_path / "study")
    assert digests(tmp_path / "study") == digests(study)


@pytest.mark.slow
def test_a_signal_at_the_end_of_a_batch_keeps_it_and_begins_no_other(settings, tmp_path, monkeypatch):
    write = StudyDirectory.write_batch

    def interrupt(self, number, *args):
        os.kill(os.getpid(), signal.SIGINT)
        write(self, number, *args)

    monkeypatch.setattr(StudyDirectory, "write_batch", interrupt)
    with pytest.raises(StoppedError):
        run_study(settings, tmp_path / "study")
    assert [path.name for path in (tmp_path / "study" / "batches").iterdir()] == ["0000"]
    assert len(pd.read_csv(tmp_path / "study" / "results.csv")) == 2 * 2


@pytest.mark.slow
def test_a_full_disk_is_said_and_the_study_goes_on_afterwards(study, settings, tmp_path):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    shutil.rmtree(folder / "batches" / "0001")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))  # no file may grow beyond it
    try:
        with pytest.raises(pecjax.InputError, match=r"cannot be written .* resumes"):
            run_study(settings, folder)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    run_study(settings, folder)
    assert digests(folder) == digests(study)


@pytest.mark.slow
def test_a_study_whose_runs_all_diverge_ends_with_one_line_and_does_not_repeat_them(
    settings, tmp_path, monkeypatch, capsys
):
    run = replace(settings.run, agent=replace(settings.run.agent, learning_rate=1e30))
    grid = grid_of(settings.run.task.table, samplers=("pec",))
    diverging = replace(settings, run=run, grid=grid, seeds=(4,))
    words = r"2 of 2 runs diverged .* sampler pec, alpha 0, seed 4: at iteration \d .*parameters.*try again"
    with pytest.raises(DivergedError, match=words) as error:
        run_study(diverging, tmp_path / "study")
    assert "\n" not in str(error.value)
    assert capsys.readouterr().err.count("; the other runs continue") == 2
    assert not StudyDirectory(tmp_path / "study").has_rows()
    monkeypatch.setattr(study_run, "several_runs", None)
    with pytest.raises(DivergedError, match=words):
        run_study(diverging, tmp_path / "study")


def test_a_run_that_diverges_is_left_out_and_all_others_are_made(
    study, settings, tmp_path, monkeypatch, capsys
):
    """As if PEC with α = 3 and seed 4 diverged: the second run of the first batch."""
    folder, asked, make = tmp_path / "study", [], study_run.several_runs

    def diverging(*args):
        made, at = make(*args), {}

        def init(seeds, numbers):
            at.update(seeds=list(seeds), iteration=0)
            return made.init(seeds, numbers)

        def iterate(state):
            state, metrics = made.program.iterate(state)
            at["iteration"] += 1
            if at == {"seeds": [4, 4], "iteration": 2}:
                asked.append(at)
                finite = {name: fine.at[1].set(False) for name, fine in metrics.finite.items()}
                metrics = metrics._replace(finite=finite)
            return state, metrics

        return made._replace(init=init, program=made.program._replace(iterate=iterate))

    monkeypatch.setattr(study_run, "several_runs", diverging)
    for _ in range(2):
        with pytest.raises(DivergedError, match=r"1 of 6 runs .* alpha 3, seed 4: at iteration 2"):
            run_study(settings, folder)
    assert len(asked) == 1  # the second time nothing is trained
    for name in TABLES:
        wanted = pd.read_csv(study / f"{name}.csv")
        wanted = wanted[~((wanted.alpha == 3) & (wanted.seed == 4))].reset_index(drop=True)
        pd.testing.assert_frame_equal(pd.read_csv(folder / f"{name}.csv"), wanted)
    for found, part, runs in zip(counted(folder), counted(study), ([0], [0, 1], [0, 1]), strict=True):
        for name in ("trials", "failures", "goal_ratio"):
            np.testing.assert_array_equal(found[name], part[name][runs])
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
    shutil.rmtree(folder / "batches" / "0000")
    monkeypatch.setattr(study_run, "several_runs", make)
    run_study(settings, folder)
    assert digests(folder) == digests(study)


def test_a_run_is_the_same_whatever_runs_are_beside_it(study, settings, tmp_path):
    """One seed alone is what it is among others, so that a pair of a study can be repeated."""
    grid = (settings.grid[0], ("sampler", ("pec",)), ("sampler.alpha", (3.0,)))
    run_study(replace(settings, grid=grid, seeds=(7,)), tmp_path / "alone")
    for name in TABLES:
        every = pd.read_csv(study / f"{name}.csv")
        wanted = every[(every.alpha == 3) & (every.seed == 7)].reset_index(drop=True)
        assert len(wanted)
        pd.testing.assert_frame_equal(
            pd.read_csv(tmp_path / "alone" / f"{name}.csv"), wanted, check_dtype=False
        )
    (alone,) = counted(tmp_path / "alone")
    assert alone["trials"].shape[0] == 1


def test_a_finished_study_only_gathers(study, settings, monkeypatch):
    monkeypatch.setattr(study_run, "several_runs", None)
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
            for damage in ("cut short", "a lost table", "no checksums", "a changed count", "lost counts")
        ),
    ],
)
def test_a_damaged_batch_is_found_said_and_made_again(damage, study, settings, tmp_path, capsys):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    path = folder / "batches" / "0001" / "results.csv"
    text = path.read_text()
    if damage == "a changed figure":
        path.write_text(text.replace("1024", "1023", 1))
    elif damage == "cut short":
        path.write_text(text[: len(text) // 2])
    elif damage == "a lost table":
        path.unlink()
    elif damage == "a changed count":
        arrays = counted(folder)[1]
        np.savez(path.with_name("configurations.npz"), **arrays | {"trials": arrays["trials"] + 1})
    elif damage == "lost counts":
        path.with_name("configurations.npz").unlink()
        sums = path.with_name("SHA256SUMS")
        sums.write_text("".join(line for line in sums.read_text().splitlines(True) if ".npz" not in line))
    else:
        (path.parent / "SHA256SUMS").write_text("")
    run_study(settings, folder)
    err = capsys.readouterr().err
    assert "0001: not as it was written; made again" in err and "2 of 3 batches are there" in err
    assert digests(folder) == digests(study)


def test_another_studys_folder_is_refused_and_the_difference_named(study, settings, monkeypatch, near_goals):
    before = digests(study)

    def refusal(**changes):
        with pytest.raises(pecjax.InputError) as error:
            run_study(replace(settings, **changes), study)
        assert digests(study) == before
        return str(error.value)

    assert "seeds ([4, 7] there, [4] here)" in refusal(seeds=(4,))
    assert "run.agent.learning_rate (0.001 there, 0.002 here)" in refusal(
        run=replace(settings.run, agent=replace(settings.run.agent, learning_rate=2e-3))
    )
    more = (*settings.grid, ("agent.clip_epsilon", (0.1,)))
    assert "grid.agent.clip_epsilon (None there, [0.1] here)" in refusal(grid=more)
    assert "order of the grid (['task.table'" in refusal(grid=settings.grid[::-1])  # batches follow it
    versions = study_directory.environment_facts(1)
    versions["versions"]["jax"] = "0.1"
    monkeypatch.setattr(study_directory, "environment_facts", lambda _: versions)
    assert "jax" in refusal()
    monkeypatch.undo()
    with open(near_goals, "a") as file:
        file.write("0 0 1 0\n")
    assert "the content of task-0/coordinates.csv" in refusal()
    with open(near_goals, "w") as file:
        file.write("0 -2 0.7 -2\n5 -2.4 5 -3.2\n-5 -2 -5 -1.2\n")


def commits(folder):
    texts = [path.read_text() for path in sorted((folder / "batches").glob("*/provenance.json"))]
    return [json.loads(text)["git_commit"] for text in texts]


def test_a_study_that_goes_on_at_another_commit_says_so_and_keeps_both(study, settings, tmp_path, capsys):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    began = json.loads((study / "study.json").read_text())
    shutil.rmtree(folder / "batches" / "0001")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(provenance, "git_commit", lambda: "f00df00d-dirty")
        run_study(settings, folder)
    commit = began["git_commit"]
    assert commits(folder) == [commit, "f00df00d-dirty", commit] and commits(study) == [commit] * 3
    if commit:  # the tests may run outside a checkout
        words = f"started at commit {provenance.short_commit(commit)} and resumed at f00df00-dirty"
        assert words in capsys.readouterr().err
    assert digests(folder) == digests(study)
    assert (folder / "study.json").read_bytes() == (study / "study.json").read_bytes()


def test_batches_need_no_provenance(study, settings, tmp_path, monkeypatch):
    monkeypatch.setattr(study_run, "several_runs", None)
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    for path in (folder / "batches").glob("*/SHA256SUMS"):
        (path.parent / "provenance.json").unlink()
        lines = path.read_text().splitlines(True)
        path.write_text("".join(line for line in lines if "provenance" not in line))
    run_study(settings, folder)
    assert digests(folder) == digests(study)


def test_a_batch_with_an_empty_table_is_no_traceback(study, settings, tmp_path, monkeypatch):
    monkeypatch.setattr(study_run, "several_runs", None)
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    path = folder / "batches" / "0001" / "metrics.csv"
    sums = path.with_name("SHA256SUMS")
    empty = hashlib.sha256(b"").hexdigest()
    sums.write_text(sums.read_text().replace(hashlib.sha256(path.read_bytes()).hexdigest(), empty))
    path.write_bytes(b"")
    run_study(settings, folder)
    assert len(pd.read_csv(folder / "metrics.csv")) == 4 * 3


def test_a_study_that_begins_while_another_looks_at_the_folder_is_left_alone(settings, tmp_path, monkeypatch):
    folder, free = tmp_path / "study", study_directory.files.check_free

    def look(path):
        free(path)
        monkeypatch.setattr(study_directory.files, "check_free", free)
        with monkeypatch.context() as patched:
            patched.setattr("pecjax.studies.run._make_batches", lambda *_: None)
            run_study(replace(settings, seeds=(9,)), folder)

    monkeypatch.setattr(study_directory.files, "check_free", look)
    with pytest.raises(pecjax.InputError, match=r"differs in settings.seeds|differs in seeds"):
        run_study(settings, folder)
    assert StudyDirectory(folder).settings().seeds == (9,)
    with alone(folder), pytest.raises(pecjax.InputError, match="another process trains here"):
        run_study(settings, folder)


def test_what_else_lies_among_the_batches_is_left_alone(study, settings, tmp_path):
    folder = tmp_path / "study"
    shutil.copytree(study, folder)
    shutil.copytree(folder / "batches" / "0001", folder / "batches" / "0001 copy")
    (folder / "batches" / ".DS_Store").write_text("")
    run_study(settings, folder)
    assert digests(folder) == digests(study)
    assert (folder / "batches" / ".DS_Store").exists()


@pytest.mark.slow
def test_a_study_killed_while_its_folder_is_made_begins_again(study, settings, tmp_path, monkeypatch):
    def kill(*_):
        raise KilledError

    place = tmp_path / "here"
    place.mkdir()
    monkeypatch.chdir(place)  # a folder that is there and empty will do
    with monkeypatch.context() as patched:
        patched.setattr("pecjax.envs.rooms.settings.table_text", lambda table: table.no_such_thing)
        with pytest.raises(AttributeError):
            run_study(settings, Path("."))
    assert not list(place.iterdir())
    with monkeypatch.context() as patched:
        patched.setattr(study_directory.os, "replace", kill)
        with pytest.raises(KilledError):
            run_study(settings, Path("."))
    assert not (place / "study.json").exists() and (place / "task-0" / "scene.xml").exists()
    run_study(settings, Path("."))
    assert digests(place) == digests(study)


def test_a_study_knows_what_its_runs_take(monkeypatch):
    apex = find_study("fig14", "smoke").run
    task, world = apex.task.make()
    asked = []
    monkeypatch.setattr("pecjax.training.build.check_memory", lambda needed, *_: asked.append(needed))
    for runs in (1, 4):
        several_runs(apex, task, world, runs)
    agent = apex.agent.make(task, pec(20))
    seen = observation_bytes(task, apex.agent.observations_held)
    assert asked == [runs * needed for runs in (1, 4) for needed in (agent.replay_bytes, seen, 0)]
    assert agent.replay_bytes > 1024 * 192 and seen > 0


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
    never = paired.loc[("pec, α = 3", "steps_to_0.95")]
    assert never.pairs == 0 and np.isnan(never.difference) and np.isnan(never.p)


def test_what_the_report_says_of_training_is_of_the_tables(study):
    study_report.write_report(study)
    runs = pd.read_csv(study / "runs.csv").set_index(["condition", "seed"])
    metrics = pd.read_csv(study / "metrics.csv")
    mine = (metrics.alpha == 3) & (metrics.seed == 7)
    run = runs.loc[("pec, α = 3", 7)]
    assert run.training_goal_ratio == pytest.approx(metrics[mine].goal_ratio.mean(), rel=1e-5)
    trials, failures = (counted(study)[2][name][1, -1] for name in ("trials", "failures"))
    trial = trials / trials.sum()
    assert (run.least_trial_ratio, run.greatest_trial_ratio) == pytest.approx((trial.min(), trial.max()))
    assert run.failure_ratio == pytest.approx((failures / trials).mean(), rel=1e-5)
    assert np.isnan(runs.alpha[("uniform", 4)]) and run.alpha == 3


def test_every_figure_of_a_study_is_drawn(study):
    paths = study_figures.draw_study(study)
    names = {path.stem for path in paths}
    assert names == {
        *("goal_ratio", "evaluation", "spread", "exit", "steps_to_threshold", "map", "alpha"),
        *("configurations-pec-0", "configurations-pec-3", "configurations-uniform"),
    }
    assert {path.suffix for path in paths} == {".pdf", ".png"} and all(path.is_file() for path in paths)


def test_the_pace_of_a_study_is_that_of_whole_batches_of_rows(monkeypatch, capsys):
    """Two runs of 100 iterations of 64 steps; after the first come 49 every 100 s, all at once."""
    monkeypatch.setenv("FORCE_COLOR", "1")  # as in notebooks; lines are printed nevertheless
    now = iter([0.0] + 49 * [100.0] + [100.0] + 50 * [200.0] + [200.0])
    clock = types.SimpleNamespace(monotonic=lambda: next(now))
    monkeypatch.setattr("pecjax.training.sinks.progress.time", clock)
    progress = Progress(200)
    for iteration in range(1, 101):
        row = {"iteration": iteration, "env_steps": 64 * iteration, "goal_ratio": 0.5, "episodes": 3}
        progress.rows("metrics", [row, row])
        if iteration % 50 == 0:
            progress.rows("evaluation", [row, row])
    assert capsys.readouterr().err.splitlines() == [
        "iteration 100/200: training goal ratio 0.500 of 6 episode(s), 63 steps/s, 102 s left",
        "iteration 200/200: training goal ratio 0.500 of 6 episode(s), 63 steps/s, 0 s left",
    ]
