"""Whole runs, tiny ones: what they leave in their folder, and that it is true."""

import json
import os
import re
from dataclasses import replace

import jax
import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

import pecjax
from pecjax.agents.apex.replay import ReplaySettings
from pecjax.envs.rooms.settings import Rooms
from pecjax.plotting import run as run_figures
from pecjax.runtime import devices
from pecjax.studies.catalogue import find_study
from pecjax.training import build as assembly, presets, train as training
from pecjax.training.checkpoint import Checkpoints
from pecjax.training.load import open_run
from pecjax.training.loop import Position
from pecjax.training.measures import cvar
from pecjax.training.presets import PRESETS
from pecjax.training.program import compile_evaluator
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_episodes import success_by_config
from pecjax.training.run_tables import configuration_table, trajectory_table
from pecjax.training.settings import StopSettings, override
from pecjax.training.sinks import Sink

SMOKE = find_study("fig4", "smoke").run
TINY = replace(
    SMOKE,
    agent=replace(SMOKE.agent, num_steps=64),
    stop=StopSettings(iterations=5),
    evaluation=replace(SMOKE.evaluation, every=2, episodes=6),
    configurations_every=2,
)

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


class Heard(Sink):
    """Everything that a sink is told, in order."""

    def __init__(self):
        self.told = []

    def open(self, runs, iteration):
        self.told.append(("open", list(runs), iteration))

    def rows(self, table, rows):
        self.told.append((table, *rows))

    def arrays(self, name, iteration, arrays):
        self.told.append((name, iteration, *arrays))

    def close(self):
        self.told.append(("close",))


HEARD = Heard()


@pytest.fixture(scope="module")
def run(folders):
    """A finished run and what `train` said of it."""
    summary = training.train(TINY, folders / "run", devices=2, sinks=[HEARD])
    return folders / "run", summary


def tables_of(folder):
    directory = RunDirectory(folder)
    return {
        "metrics": pd.read_csv(folder / "metrics.csv"),
        "evaluation": pd.read_csv(folder / "evaluation.csv"),
        "configurations": configuration_table(directory),
        "trajectories": trajectory_table(directory),
    }


@pytest.fixture(scope="module")
def tables(run):
    return tables_of(run[0])


def test_every_file_of_the_run_directory_is_there_with_its_columns(run, tables):
    folder, _ = run
    there = {path.name for path in folder.iterdir()}
    folders = {"configurations", "episodes", "checkpoints", "states", "figures"}
    tables_and_summary = {"metrics.csv", "evaluation.csv", "summary.json"}
    given = {".lock", "config.json", "scene.xml", "coordinates.csv"}
    assert there == given | tables_and_summary | folders
    head = ["iteration", "env_steps", "seconds", "goal_ratio", "episodes", "mean_return", "mean_length"]
    of_task = ["collision", "path_length", "timeout", "unstable"]
    learners = ["entropy", "kl", "kl_coeff", "policy_loss", "value_loss"]
    draws = ["effective_configs", "greatest_probability", "least_probability", "never_solved", "untried"]
    assert list(tables["metrics"].columns) == head + of_task + learners + draws
    columns = ["iteration", "config", "trials", "failures", "probability"]
    assert list(tables["configurations"].columns) == columns
    # As many columns for a million configurations as for twenty.
    head = ["iteration", "env_steps", "goal_ratio", "cvar", "mean_return", "mean_length"]
    assert list(tables["evaluation"].columns) == head + of_task
    assert list(tables["trajectories"].columns) == ["episode", "config", "success", "step", "x", "y"]


def test_arrays_of_all_configurations_and_episodes(run):
    directory = RunDirectory(run[0])
    assert directory.iterations("configurations") == [1, 2, 4, 5]
    for iteration in (1, 2, 4, 5):
        arrays = directory.arrays("configurations", iteration)
        assert {name: array.shape for name, array in arrays.items()} == dict.fromkeys(
            ("trials", "failures", "steps", "probability"), (20,)
        )
    assert directory.iterations("episodes") == [2, 4, 5]
    of_task = {"collision", "path_length", "timeout", "unstable"}
    for iteration in (2, 4, 5):
        arrays = directory.arrays("episodes", iteration)
        flown = {"config_id", "success", "return", "length"} | of_task
        # Paths are of the last evaluation only.
        assert set(arrays) == (flown | {"recorded", "poses", "actions"} if iteration == 5 else flown)
        assert all(arrays[name].shape == (6,) for name in flown)
        endings = arrays["success"].astype(int) + arrays["collision"] + arrays["timeout"]
        assert np.all(endings == 1)
    with pytest.raises(pecjax.InputError, match=r"episodes/3.npz: cannot be read"):
        directory.arrays("episodes", 3)


def test_rows_come_when_they_should_and_count_their_steps(tables):
    metrics, evaluation = tables["metrics"], tables["evaluation"]
    assert metrics.iteration.tolist() == [1, 2, 3, 4, 5]
    assert metrics.env_steps.tolist() == [512, 1024, 1536, 2048, 2560]
    assert metrics.seconds.is_monotonic_increasing and metrics.seconds.iloc[0] > 0
    assert evaluation.iteration.tolist() == [2, 4, 5]
    assert evaluation.env_steps.tolist() == [1024, 2048, 2560]
    # The first, every second, and the last.
    assert sorted(set(tables["configurations"].iteration)) == [1, 2, 4, 5]
    assert np.all(tables["configurations"].groupby("iteration").config.apply(list).map(len) == 20)


def test_counts_of_configurations_add_up_to_the_metrics(run, tables):
    metrics = tables["metrics"].set_index("iteration")
    totals = tables["configurations"].groupby("iteration")[["trials", "failures"]].sum()
    episodes = metrics.episodes.cumsum()
    assert episodes.iloc[-1] > 20
    np.testing.assert_array_equal(totals.trials, episodes.loc[totals.index])
    failures = (metrics.episodes * (1 - metrics.goal_ratio.fillna(0))).cumsum()
    np.testing.assert_allclose(totals.failures, failures.loc[totals.index], atol=1e-3)
    # What has ended has reached its goal, hit something or run out of time.
    endings = metrics[["goal_ratio", "collision", "timeout"]].sum(axis=1)[metrics.episodes > 0]
    np.testing.assert_allclose(endings, 1, rtol=1e-6)
    directory = RunDirectory(run[0])
    steps = [directory.arrays("configurations", iteration)["steps"].sum() for iteration in totals.index]
    flown = (metrics.episodes * metrics.mean_length.fillna(0)).cumsum()
    np.testing.assert_allclose(steps, flown.loc[totals.index], rtol=1e-5)
    # An episode's mean length, times their number, cannot exceed the steps flown.
    assert np.all((metrics.episodes * metrics.mean_length.fillna(0)).cumsum() <= metrics.env_steps)


def test_figures_of_an_evaluation_are_those_of_its_episodes(run, tables):
    directory = RunDirectory(run[0])
    for row in tables["evaluation"].itertuples():
        episodes = directory.arrays("episodes", row.iteration)
        for column, name in (
            ("goal_ratio", "success"),
            ("mean_return", "return"),
            ("mean_length", "length"),
            *((name, name) for name in ("collision", "path_length", "timeout", "unstable")),
        ):
            np.testing.assert_allclose(getattr(row, column), episodes[name].mean(), rtol=1e-6)
        by_config = pd.Series(episodes["success"]).groupby(episodes["config_id"]).mean()
        worst = by_config.sort_values().head(max(1, round(len(by_config) / 10)))
        np.testing.assert_allclose(row.cvar, worst.mean(), rtol=1e-6)


def test_sinks_hear_of_everything_in_its_order(run, tables):
    told = HEARD.told
    assert told[0] == ("open", [str(run[0])], 0) and told[-1] == ("close",)
    names = [what for what, *_ in told[1:-1]]
    one, counted, evaluated = ["metrics"], ["configurations"], ["evaluation", "episodes"]
    due = one + counted, one + counted + evaluated, one, one + counted + evaluated
    assert names == [name for part in (*due, due[1]) for name in part]
    heard = pd.DataFrame([row for what, row, *_ in told[1:-1] if what == "metrics"])
    written = tables["metrics"].drop(columns="seconds")
    pd.testing.assert_frame_equal(heard[written.columns], written, check_dtype=False, rtol=1e-6)
    kept = RunDirectory(run[0])
    for what, iteration, *arrays in told[1:-1]:
        if what in ("configurations", "episodes"):
            assert len(arrays) == 1 and arrays[0].keys() == kept.arrays(what, iteration).keys()
            for name, array in kept.arrays(what, iteration).items():
                np.testing.assert_array_equal(arrays[0][name], array)


def test_probabilities_obey_equations_1_and_2(tables):
    for _, rows in tables["configurations"].groupby("iteration"):
        tried = rows.trials > 0
        priority = np.where(tried, rows.failures / rows.trials.where(tried, 1) + TINY.sampler.alpha, 1.0)
        np.testing.assert_allclose(rows.probability, priority / priority.sum(), rtol=2e-6)
        np.testing.assert_allclose(rows.probability.sum(), 1, rtol=1e-6)
    assert rows.probability.nunique() > 1


def test_config_json_reads_back_and_names_what_a_figure_needs(run):
    folder, _ = run
    assert RunDirectory(folder).settings() == TINY
    config = json.loads((folder / "config.json").read_text())
    assert {"settings", "versions", "devices", "git_commit", "files", "sessions"} <= set(config)
    assert config["settings"]["seed"] == 0
    assert config["files"] == ["scene.xml", "coordinates.csv"]
    assert config["versions"]["jax"] == jax.__version__
    assert config["devices"]["used"] == 2


def test_a_run_keeps_its_map_and_its_coordinates(run):
    """So that it can be evaluated after the files it was given are gone."""
    kept, given = RunDirectory(run[0]).task(), Rooms()
    jax.tree.map(np.testing.assert_array_equal, kept.configurations(), pecjax.COORDINATE_SET_1)
    assert kept.table == str(run[0] / "coordinates.csv") and kept.maps == (str(run[0] / "scene.xml"),)
    ((one,), (other,)) = kept.scenes(), given.scenes()
    for name in ("lower", "upper", "bounds"):
        np.testing.assert_allclose(getattr(one.map, name), getattr(other.map, name), rtol=1e-6)
    for name in ("radius", "mass", "inertia", "timestep", "gravity"):
        np.testing.assert_allclose(
            getattr(one.vehicle, name), getattr(other.vehicle, name), rtol=1e-6, err_msg=name
        )
    np.testing.assert_allclose(one.vehicle.rotors.wrench, other.vehicle.rotors.wrench, rtol=1e-6)
    for name in ("height", "width", "fovy", "near", "far"):
        assert getattr(one.vehicle.camera, name) == getattr(other.vehicle.camera, name)


def test_summary_says_what_the_tables_say(run, tables):
    folder, summary = run
    assert json.loads((folder / "summary.json").read_text()) == summary
    assert summary["iterations"] == 5 and summary["env_steps"] == 2560
    last = tables["evaluation"].iloc[-1]
    np.testing.assert_allclose(summary["uniform_evaluation"]["goal_ratio"], last.goal_ratio, rtol=1e-6)
    np.testing.assert_allclose(summary["uniform_evaluation"]["mean_return"], last.mean_return, rtol=1e-6)
    assert summary["seconds"] >= tables["metrics"].seconds.iloc[-1] - 0.01


def test_a_checkpoint_flies_the_evaluation_that_was_written_down(run, tables):
    folder, _ = run
    directory = RunDirectory(folder)
    again = assembly.build(replace(TINY, task=directory.task()), num_devices=2)
    like = assembly.abstract_state(again).learner
    checkpoints = Checkpoints(folder)
    assert checkpoints.iterations() == [2, 4, 5]
    fly = compile_evaluator(again, TINY, like)
    for iteration in (2, None):
        found, learner = checkpoints.load_learner(like, iteration)
        assert found == (iteration or 5)
        flights = fly(learner, again.world)
        row = tables["evaluation"].set_index("iteration").loc[found]
        np.testing.assert_allclose(flights.success.mean(), row.goal_ratio, rtol=1e-6)
        np.testing.assert_allclose(flights.returns.mean(), row.mean_return, rtol=1e-6)
        ratios = success_by_config(flights.config_id, flights.success, 20)
        np.testing.assert_allclose(cvar(ratios), row.cvar, rtol=1e-6)
        episodes = directory.arrays("episodes", found)
        for name, array in (
            ("config_id", flights.config_id),
            ("success", flights.success),
            ("return", flights.returns),
            ("length", flights.lengths),
        ):
            np.testing.assert_array_equal(episodes[name], array)
    with pytest.raises(pecjax.InputError, match="no checkpoint 3; there are 2, 4, 5"):
        checkpoints.load_learner(like, 3)


def test_a_run_that_is_opened_flies_its_evaluation_and_other_worlds(run, tables):
    trained = open_run(run[0], checkpoint=4)
    assert trained.iteration == 4 and trained.run.num_configs == 20
    fly = trained.evaluator()
    row = tables["evaluation"].set_index("iteration").loc[4]
    np.testing.assert_allclose(fly().returns.mean(), row.mean_return, rtol=1e-6)
    world = trained.run.world
    backwards = jax.tree.map(lambda leaf: leaf[::-1], world.table)
    assert np.any(fly(world._replace(table=backwards)).poses[:, 0] != fly().poses[:, 0])
    # Greedy actions repeat themselves: one observation always leads to the same action.
    state = trained.run.task.reset(jax.random.key(1), jax.tree.map(lambda leaf: leaf[0], world.table), None)
    seen = trained.run.task.observe(jax.random.key(2), state, world.params)
    act = jax.jit(trained.policy())
    assert act(seen, jax.random.key(3)) == act(seen, jax.random.key(4)) in range(15)


def test_trajectories_lead_from_start_towards_the_written_end(tables):
    table = pecjax.COORDINATE_SET_1
    for _, path in tables["trajectories"].groupby("episode"):
        config = path.config.iloc[0]
        np.testing.assert_allclose(path[["x", "y"]].iloc[0], table.start[config], atol=1e-6)
        assert path.step.tolist() == list(range(len(path)))
        distance = np.linalg.norm(path[["x", "y"]].iloc[-1] - table.goal[config])
        assert (distance < 0.5) == bool(path.success.iloc[0])


def test_trajectories_are_the_first_flights_of_each_configuration(run, tables):
    episodes = RunDirectory(run[0]).arrays("episodes", 5)
    # Six episodes, each in a configuration of its own: all of them are kept.
    assert sorted(tables["trajectories"].episode.unique()) == list(range(6))
    for episode, path in tables["trajectories"].groupby("episode"):
        assert len(path) == episodes["length"][episode] + 1
        assert set(path.config) == {episodes["config_id"][episode]}


def test_figures_are_drawn_and_show_something(run):
    paths = run_figures.draw_run(run[0])
    assert {path.suffix for path in paths} == {".pdf", ".png"}
    assert len(paths) == len(set(paths)) >= 8
    for path in paths:
        assert path.parent == run[0] / "figures" and path.stat().st_size > 5000
        if path.suffix == ".png":
            pixels = imread(path)
            assert min(pixels.shape[:2]) > 300 and 0.01 < np.std(pixels) < 0.6
        else:
            assert path.read_bytes().rstrip().endswith(b"%%EOF")
    before = {path: path.read_bytes() for path in paths if path.suffix == ".pdf"}
    run_figures.draw_run(run[0])
    assert all(path.read_bytes() == content for path, content in before.items())


def test_a_seed_says_it_all(run, folders):
    training.train(TINY, folders / "again", devices=2)
    tables = [tables_of(folder) for folder in (run[0], folders / "again")]
    for one, two in zip(*(of_run.values() for of_run in tables), strict=True):
        pd.testing.assert_frame_equal(
            one.drop(columns="seconds", errors="ignore"),
            two.drop(columns="seconds", errors="ignore"),
            check_exact=True,
        )
    training.train(override(TINY, seed=1, iterations=1), folders / "other", devices=2)
    columns = ["mean_return", "entropy", "kl"]
    one, other = (pd.read_csv(f / "metrics.csv")[columns] for f in (run[0], folders / "other"))
    assert np.all(other.iloc[0] != one.iloc[0])


def test_a_map_with_files_of_its_own_is_kept_whole(tmp_path, edited_rooms, monkeypatch):
    mesh = '<asset><mesh name="m" file="m.obj"/></asset><worldbody>'
    shown = '<geom type="mesh" mesh="m" contype="0" conaffinity="0"/><body name="drone"'
    path = edited_rooms(("<worldbody>", mesh), ('<body name="drone"', shown))
    (path.parent / "meshes").mkdir()
    path = path.rename(path.parent / "meshes" / "rooms.xml")
    (path.parent / "m.obj").write_text(TETRAHEDRON)
    # Everything up to the first iteration is what this is about.
    monkeypatch.setattr(training, "started", lambda session: (None, None))

    def loop(session, *_):
        (scene,) = session.settings.task.scenes()
        return {"kept in": session.settings.task.maps[0], "walls": scene.map.names}

    monkeypatch.setattr(training, "_loop", loop)
    found = training.train(override(TINY, scene=(str(path),)), tmp_path / "run")
    assert len(found["walls"]) == 14 and found["kept in"] == str(tmp_path / "run" / "scene.xml")


def test_a_folder_is_not_written_twice(run, folders):
    before = sorted(path.name for path in run[0].iterdir())
    with pytest.raises(pecjax.InputError, match="holds another run"):
        training.train(TINY, run[0])
    assert sorted(path.name for path in run[0].iterdir()) == before
    (folders / "notes").mkdir()
    (folders / "notes" / "mine.txt").write_text("keep me")
    with pytest.raises(pecjax.InputError, match="is not empty"):
        training.train(TINY, folders / "notes")
    assert [path.name for path in (folders / "notes").iterdir()] == ["mine.txt"]


SOON = pecjax.Configurations(
    np.array([[0, -2], [5, -2.4], [-5, -2]], np.float32),
    np.array([[0.7, -2], [5, -3.2], [-5, -1.2]], np.float32),
)


@pytest.fixture(scope="module")
def near_goals(folders):
    path = folders / "near.csv"
    np.savetxt(path, np.hstack([SOON.start, SOON.goal]), delimiter=",")
    return str(path)


def test_every_learner_is_kept_and_of_the_rest_the_newest_two(run):
    folder, _ = run
    assert Checkpoints(folder).iterations() == [2, 4, 5]
    assert sorted(path.name for path in (folder / "states").iterdir()) == ["4.npz", "5.npz"]


@pytest.mark.slow
def test_a_run_of_apex_leaves_the_same_files_and_its_policy_can_be_had(
    folders, near_goals, capsys, monkeypatch
):
    settings = override(presets.find_preset(agent="apex"), num_envs=8, coordinates=near_goals)
    assert settings.agent.rollout_length * 8 == PRESETS["apex-fast"].agent.rollout_length * 512
    small = replace(settings.agent, num_steps=128, learning_starts=1024, replay=ReplaySettings(capacity=4096))
    about = replace(settings.evaluation, every=2, episodes=6)
    settings = override(replace(settings, agent=small, evaluation=about), iterations=3)
    folder = folders / "apex"
    summary = training.train(settings, folder, devices=2)
    metrics = pd.read_csv(folder / "metrics.csv")
    assert metrics.env_steps.tolist() == [1024, 2048, 3072] and summary["env_steps"] == 3072
    rounds = 3 * 128 // small.rollout_length
    assert metrics.updates.iloc[-1] == rounds * small.updates
    assert (metrics.episodes > 0).all() and metrics.goal_ratio.between(0, 1).all()
    counts = configuration_table(RunDirectory(folder))
    assert counts[counts.iteration == 3].trials.sum() == metrics.episodes.sum()
    err = capsys.readouterr().err
    assert "replay: 1 MB" in err and re.search(r"training goal ratio \d\.\d{3} of \d+ episode\(s\)", err)
    assert run_figures.draw_run(folder)
    directory = RunDirectory(folder)
    assert directory.settings() == settings
    trained = open_run(str(folder))
    flights = trained.evaluator()()
    assert trained.iteration == 3
    assert flights.success.mean() == summary["uniform_evaluation"]["goal_ratio"]
    # A policy is flown without its replay, however large: only a training needs room for it.
    monkeypatch.setattr(devices.os, "sysconf", lambda name: 1)
    with pytest.raises(pecjax.InputError, match="the transitions of the replay take"):
        training.resume(override(settings, iterations=9), folder)
    for mine, theirs in zip(*map(jax.tree.leaves, (open_run(folder).learner, trained.learner)), strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_a_run_ends_once_its_goal_ratio_has_been_held(folders, near_goals):
    # Whatever is flown, some of goals so near are reached; three in a row are asked of ten.
    settings = override(TINY, coordinates=near_goals, iterations=10, until_goal_ratio=0.01, patience=3)
    summary = training.train(settings, folders / "held")
    ratios = pd.read_csv(folders / "held" / "metrics.csv").goal_ratio
    held = (ratios >= 0.01).rolling(3).sum() == 3
    assert held.any() and summary["iterations"] == len(ratios) == held.idxmax() + 1 < 10
    # It ends like any other: with an evaluation and a checkpoint.
    assert pd.read_csv(folders / "held" / "evaluation.csv").iteration.iloc[-1] == len(ratios)
    assert Checkpoints(folders / "held").iterations()[-1] == len(ratios)


@pytest.mark.parametrize(
    ("agent", "num_envs", "wanted", "words"),
    [
        ("ppo", 6, None, "6 environments on 3 of 4 devices; --num-envs 4 or 8 would use all of them"),
        ("ppo", 3, None, "3 environments on 3 of 4 devices; --num-envs 4 would use all of them"),
        ("ppo", 8, None, "8 environments on 4 of 4 devices"),
        ("ppo", 8, 2, "8 environments on 2 of 4 devices"),
        ("apex", 512, None, "512 environments on 2 of 4 devices; they share the work by its 2 replay shards"),
    ],
)
def test_devices_that_stay_idle_are_named(agent, num_envs, wanted, words, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(training, "started", lambda session: (Position(None), None))
    monkeypatch.setattr(training, "_loop", lambda *_: {})
    settings = override(presets.find_preset(agent=agent), num_envs=num_envs)
    if agent == "apex":
        replay = replace(settings.agent.replay, num_shards=2)
        settings = replace(settings, agent=replace(settings.agent, replay=replay))
    training.train(settings, tmp_path / "run", wanted)
    assert f"run: {words}\n" in capsys.readouterr().err


def test_cores_are_counted_on_systems_that_tell_less(monkeypatch):
    assert devices.num_cores() == len(os.sched_getaffinity(0))
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    monkeypatch.delattr(os, "process_cpu_count", raising=False)
    assert devices.num_cores() == 6
    monkeypatch.setattr(os, "process_cpu_count", lambda: 3, raising=False)
    assert devices.num_cores() == 3
    asked = {}
    monkeypatch.setattr(devices.jax.config, "update", asked.__setitem__)
    devices.use_all_cores()
    assert asked == {"jax_num_cpu_devices": 3}


def test_a_replay_that_cannot_fit_is_refused_before_anything_is_written(folders):
    huge = replace(PRESETS["apex-fast"].agent, replay=ReplaySettings(capacity=2**36))
    settings = replace(PRESETS["apex-fast"], agent=huge)
    with pytest.raises(
        pecjax.InputError, match=r"the transitions of the replay take \d+\.\d GB and there are"
    ):
        training.train(settings, folders / "huge")
    assert not (folders / "huge").exists()
