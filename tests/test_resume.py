"""Stopping and going on: bit for bit the training that never stopped, whatever stopped it."""

import itertools
import json
import os
import resource
import shutil
import signal
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
from every_axis import write_table
from hypothesis import given, settings, strategies
from hypothesis.extra.numpy import array_shapes, arrays as arrays_of

import pecjax
from pecjax import agents
from pecjax.agents.apex.q_network import QNetworkSettings
from pecjax.agents.apex.replay import ReplaySettings
from pecjax.agents.networks import NetworkSettings
from pecjax.cli import main
from pecjax.curriculum import PEC
from pecjax.envs.axes import axes_of
from pecjax.envs.rooms.settings import Rooms
from pecjax.errors import DivergedError, StoppedError
from pecjax.runtime import provenance
from pecjax.settings_tree import from_json, to_json
from pecjax.storage.arrays import CorruptFileError, read_arrays, write_arrays
from pecjax.storage.files import alone
from pecjax.studies.catalogue import find_study
from pecjax.studies.grid import StudySettings
from pecjax.training import loop, session, train as training
from pecjax.training.former_versions import run_settings, study_settings
from pecjax.training.load import open_run
from pecjax.training.presets import PRESETS
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import configuration_table, trajectory_table
from pecjax.training.settings import EvaluationSettings, RunSettings, StopSettings, override


def short(settings):
    evaluation = replace(settings.evaluation, every=2, episodes=6)
    return override(replace(settings, evaluation=evaluation, configurations_every=4), iterations=6)


PPO = short(find_study("fig4", "smoke").run)
APEX = short(
    replace(
        PRESETS["apex-fast"],
        agent=replace(
            PRESETS["apex-fast"].agent.with_envs(8),
            num_steps=128,
            learning_starts=512,
            network=QNetworkSettings(trunk=(8,), head=8),
            replay=ReplaySettings(capacity=4096),
        ),
    )
)


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


def arrays(folder, name):
    with np.load(folder / name) as file:
        return {key: file[key] for key in file.files if key not in (".seconds", "about")}


def assert_same_run(one, other):
    """All but the time that it took."""
    for name in ("evaluation.csv", "coordinates.csv", "scene.xml"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    tables = [pd.read_csv(f / "metrics.csv", dtype=str).drop(columns="seconds") for f in (one, other)]
    pd.testing.assert_frame_equal(*tables)
    names = [sorted(str(p.relative_to(f)) for p in f.rglob("*.npz")) for f in (one, other)]
    assert names[0] == names[1]
    assert {os.path.dirname(name) for name in names[0]} == {
        "checkpoints", "configurations", "episodes", "states"
    }  # fmt: skip
    for name in names[0]:
        first, second = arrays(one, name), arrays(other, name)
        assert first.keys() == second.keys() and len(first) >= 3
        for key in first:
            np.testing.assert_array_equal(first[key], second[key], err_msg=f"{name} {key}")


@pytest.fixture(scope="module")
def whole(folders):
    """(settings, devices) -> the folder of that training, never stopped."""
    made = {}

    def get(settings, devices):
        key = (settings, devices)
        if key not in made:
            made[key] = folders / f"whole-{len(made)}"
            training.train(settings, made[key], devices)
        return made[key]

    return get


REMEMBERS = replace(PPO, agent=replace(PPO.agent, network=NetworkSettings(hidden=(8,), memory="gru")))
CASES = [
    pytest.param(PPO, "pec", 1, id="ppo-pec-1"),
    pytest.param(REMEMBERS, "pec", 2, id="ppo-gru-pec-2"),
    pytest.param(PPO, "uniform", 2, id="ppo-uniform-2", marks=pytest.mark.slow),
    pytest.param(PPO, "mixture", 2, id="ppo-mixture-2", marks=pytest.mark.slow),
    pytest.param(PPO, "plr", 2, id="ppo-plr-2", marks=pytest.mark.slow),
    pytest.param(PPO, "thompson", 1, id="ppo-thompson-1", marks=pytest.mark.slow),
    pytest.param(APEX, "pec", 2, id="apex-pec-2", marks=pytest.mark.slow),
    pytest.param(APEX, "uniform", 1, id="apex-uniform-1", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("settings", "sampler", "devices"), CASES)
@pytest.mark.parametrize("stop_at", [3, 4])
def test_two_parts_of_a_training_are_the_whole(stop_at, settings, sampler, devices, whole, tmp_path):
    """Whether or not the first of them ends with an evaluation that the whole has too."""
    settings = override(settings, sampler=sampler)
    folder = tmp_path / "run"
    training.train(override(settings, iterations=stop_at), folder, devices)
    assert (folder / "summary.json").exists()
    summary = training.resume(settings, folder)
    assert_same_run(whole(settings, devices), folder)
    assert summary["iterations"] == 6
    directory = RunDirectory(folder)
    assert directory.settings() == settings and directory.num_devices() == devices
    seconds = pd.read_csv(folder / "metrics.csv").seconds
    assert seconds.is_monotonic_increasing


def in_the_words_of_0_1(settings, *, first):
    """The settings of a run as version 0.1 wrote them: in one level, and those of both learners.

    Args:
        first: whether as the first 0.1 did: a sampler's name, and α for all.
    """
    task, agent = settings["task"], settings["agent"]
    name = agent.pop("kind").rpartition(":")[2].lower()
    for former, today in (("clip", "clip_epsilon"), ("fragment", "rollout_length"), ("huber", "huber_delta")):
        if today in agent:
            agent[former] = agent.pop(today)
    sampler = dict(settings["sampler"])
    if first:
        kind = sampler.pop("kind").rpartition(":")[2].lower()
        sampler = {"alpha": sampler.get("alpha", 0.2), "sampler": kind}
    else:
        sampler = {"sampler": sampler}
    evaluation = settings["evaluation"]
    return {
        "preset": settings["preset"],
        "algorithm": name,
        "ppo": {"num_envs": 512, "clip": 0.2},
        "apex": {"num_envs": 512, "fragment": 2, "huber": 1.0},
        name: agent,
        "resolution": task["resolution"],
        **sampler,
        "coordinates": task["table"],
        "scene": task["maps"][0] if task["maps"] else None,
        "seed": settings["seed"],
        **settings["stop"],
        "evaluate_every": evaluation["every"],
        "evaluation_episodes": evaluation["episodes"],
        "evaluation_seed": evaluation["seed"],
        "greedy": evaluation["greedy"],
        "configurations_every": settings["configurations_every"],
    }


def as_version_0_1(folder, *, first=False):
    """Makes a run's folder one of version 0.1: settings in one level, other tables, other states."""
    directory = RunDirectory(folder)
    counts, flights = configuration_table(directory), trajectory_table(directory)
    counts.to_csv(folder / "configurations.csv", index=False)
    flights.rename(columns={"success": "goal"}).to_csv(folder / "trajectories.csv", index=False)
    metrics = pd.read_csv(folder / "metrics.csv", dtype=str)
    metrics.drop(columns=["collision", "timeout"]).to_csv(folder / "metrics.csv", index=False)
    evaluation = pd.read_csv(folder / "evaluation.csv")
    kept = ["iteration", "env_steps", "goal_ratio", "mean_return"]
    for iteration in evaluation.iteration:
        episodes = directory.arrays("episodes", iteration)
        ratios = pd.Series(episodes["success"]).groupby(episodes["config_id"]).mean()
        evaluation.loc[evaluation.iteration == iteration, [f"c{n}" for n in ratios.index]] = ratios.to_numpy()
    columns = [f"c{number}" for number in range(counts.config.max() + 1)]
    evaluation.reindex(columns=kept + columns).to_csv(folder / "evaluation.csv", index=False)
    for name in ("configurations", "episodes"):
        shutil.rmtree(folder / name)
    config = json.loads((folder / "config.json").read_text())
    config["settings"] = in_the_words_of_0_1(config["settings"], first=first)
    del config["files"]
    for facts in (config, *config["sessions"]):
        facts["versions"]["pecjax"] = "0.1.0"
    if first:
        del config["sessions"]
    (folder / "config.json").write_text(json.dumps(config))
    for path in (folder / "states").iterdir():
        with np.load(path) as file:
            parts = {key.replace(".envs", ".fleet"): file[key] for key in file.files}
        about = {"settings": config["settings"], "version": "0.1.0"}
        parts["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
        np.savez(path, **parts)


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize(("settings", "sampler", "devices"), CASES)
def test_a_run_of_version_0_1_is_read_flown_and_drawn_but_not_resumed(
    settings, sampler, devices, first, whole, tmp_path, capsys
):
    settings = override(settings, sampler=sampler)
    today, folder = whole(settings, devices), tmp_path / "run"
    shutil.copytree(today, folder)
    as_version_0_1(folder, first=first)
    assert (b'"alpha": 0.2, "sampler"' in (folder / "config.json").read_bytes()) == first
    assert RunDirectory(folder).settings() == settings
    assert RunDirectory(folder).num_devices() == devices
    for checkpoint in (2, None):
        flights, wanted = (open_run(run, checkpoint).evaluator()() for run in (folder, today))
        jax.tree.map(np.testing.assert_array_equal, flights, wanted)
    for table in (configuration_table, trajectory_table):
        tables = [table(RunDirectory(run)) for run in (folder, today)]
        pd.testing.assert_frame_equal(*tables, check_dtype=False, rtol=1e-7)
    assert main(["figures", str(folder)]) == 0
    assert {path.suffix for path in (folder / "figures").iterdir()} == {".pdf", ".png"}
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    capsys.readouterr()
    assert main(["train", "--resume", "--out", str(folder), "--iterations", "9"]) == 2
    err = capsys.readouterr().err
    assert f"{folder}: holds a run of another version ('0.1.0' there, '0.2" in err
    assert err.count("\n") == 1 and len(err) < 300
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_settings_of_version_0_1_are_todays():
    """Of each setting that 0.1 had, whatever it is: none is left at its default by mistake."""
    former = {
        "preset": "image", "algorithm": "ppo",
        "ppo": {"num_envs": 24, "clip": 0.3, "shuffle": "samples", "network": {"hidden": [8, 9]}},
        "apex": {"num_envs": 99}, "resolution": [20, 10], "sampler": "pec", "alpha": 0.7,
        "coordinates": "2", "scene": "my.xml", "seed": 7, "iterations": 11, "until_goal_ratio": 0.9,
        "patience": 3, "evaluate_every": 5, "evaluation_episodes": 13, "evaluation_seed": 17,
        "greedy": False, "configurations_every": 19,
    }  # fmt: skip
    found = from_json(run_settings(former), RunSettings)
    assert found == RunSettings(
        preset="image",
        task=Rooms(table="2", maps=("my.xml",), resolution=(20, 10)),
        sampler=PEC(0.7),
        agent=agents.PPO(
            num_envs=24,
            clip_epsilon=0.3,
            shuffle="samples",
            network=NetworkSettings(hidden=(8, 9), critic="observation", precision="float32"),
        ),
        evaluation=EvaluationSettings(every=5, episodes=13, seed=17, greedy=False),
        stop=StopSettings(iterations=11, until_goal_ratio=0.9, patience=3),
        seed=7,
        configurations_every=19,
    )
    former |= {"algorithm": "apex", "apex": {"fragment": 4, "huber": 2.0, "replay": {"beta": 0.5}}}
    wanted = agents.Apex(rollout_length=4, huber_delta=2.0, replay=ReplaySettings(beta=0.5))
    assert from_json(run_settings(former), RunSettings).agent == wanted
    # A setting that there never was is refused, not left out.
    former["apex"]["speed"] = 3
    with pytest.raises(pecjax.InputError, match="has no setting speed"):
        from_json(run_settings(former), RunSettings)
    with pytest.raises(pecjax.InputError, match="unknown algorithm 'sac'"):
        run_settings(former | {"algorithm": "sac"})


def test_a_network_from_before_critics_were_told_more_stays_as_it_was():
    now = RunSettings(agent=agents.PPO(network=NetworkSettings(hidden=(8,), critic="observation")))
    former = to_json(now)
    del former["agent"]["network"]["critic"], former["agent"]["network"]["precision"]
    exact = replace(now.agent.network, precision="float32")
    assert from_json(run_settings(former), RunSettings).agent.network == exact
    assert from_json(run_settings(to_json(now)), RunSettings) == now
    apex = to_json(RunSettings(agent=agents.Apex()))
    assert run_settings(apex) == apex
    study = to_json(StudySettings("own", now, (("sampler", ("pec",)),))) | {"run": former}
    assert from_json(study_settings(study), StudySettings).run.agent.network == exact


@pytest.mark.parametrize(
    ("updates", "steps"), [(11_200, 5_734_400), (None, None), ("many", "many"), (float("inf"), float("inf"))]
)
def test_a_fall_over_updates_is_one_over_steps_today(updates, steps):
    former = to_json(RunSettings(agent=agents.Apex()))
    del former["agent"]["decay_steps"]
    former["agent"]["decay_updates"] = updates
    assert run_settings(former)["agent"]["decay_steps"] == steps
    assert "decay_updates" not in run_settings(former)["agent"]
    if updates == 11_200:
        assert from_json(run_settings(former), RunSettings) == RunSettings(agent=agents.Apex())


def test_a_table_that_a_space_left_unused_is_none_today():
    former = to_json(RunSettings(task=Rooms(table="1", space="rooms-pairs")))
    wanted = RunSettings(task=Rooms(space="rooms-pairs"))
    assert from_json(run_settings(former), RunSettings) == wanted
    grid = [["task.table", ["1"]], ["sampler", ["pec", "uniform"]]]
    study = to_json(StudySettings("own", wanted)) | {"grid": grid, "run": former}
    found = from_json(study_settings(study), StudySettings)
    assert found.run == wanted and found.grid == (("sampler", ("pec", "uniform")),)
    study["run"] = to_json(RunSettings(task=Rooms(table="1")))  # without a space it is what is flown
    assert study_settings(study) == study


@pytest.mark.parametrize(
    ("at", "asked"),
    [
        (3, signal.SIGINT),
        (4, signal.SIGTERM),
        *(
            pytest.param(at, asked, marks=pytest.mark.slow)
            for at, asked in [
                (1, signal.SIGINT),
                (1, signal.SIGTERM),
                (3, signal.SIGTERM),
                (4, signal.SIGINT),
            ]
        ),
    ],
)
def test_a_signal_is_seen_to_after_the_iteration(asked, at, whole, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]

    def ask(iteration, *args):
        if iteration == at:
            os.kill(os.getpid(), asked)
        return row(iteration, *args)

    row = loop.metrics_row
    monkeypatch.setattr(loop, "metrics_row", ask)
    with pytest.raises(
        StoppedError, match=f"after iteration {at}; resume with pecjax train --resume"
    ) as stop:
        training.train(PPO, folder, devices=1)
    assert stop.value.signal == asked and isinstance(stop.value, KeyboardInterrupt)
    assert [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)] == before
    monkeypatch.undo()
    training.resume(PPO, folder)
    assert_same_run(whole(PPO, 1), folder)


def test_a_second_signal_stops_at_once(tmp_path, monkeypatch):
    def ask_twice(iteration, *args):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("was not stopped")

    monkeypatch.setattr(loop, "metrics_row", ask_twice)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs tests may ignore it
    try:
        with pytest.raises(KeyboardInterrupt) as stop:
            training.train(PPO, tmp_path / "run", devices=1)
    finally:
        signal.signal(signal.SIGINT, before)
    assert not isinstance(stop.value, StoppedError)


@pytest.fixture
def stopped(whole, tmp_path):
    """A run whose last checkpoint is of iteration 4 and whose tables were written on."""
    folder = tmp_path / "run"
    shutil.copytree(whole(override(PPO, iterations=5), 1), folder)
    (folder / "states" / "5.npz").unlink()
    (folder / "summary.json").unlink()
    with (folder / "metrics.csv").open("a") as file:
        file.write("6,1536,0.1")  # half a row
    return folder


def test_rows_after_the_last_checkpoint_are_rolled_back(stopped, whole, capsys):
    training.resume(PPO, stopped)
    assert "resumes after iteration 4" in capsys.readouterr().err
    assert_same_run(whole(PPO, 1), stopped)


@pytest.mark.parametrize(
    "damage",
    [
        "changed",
        *(
            pytest.param(damage, marks=pytest.mark.slow)
            for damage in ("torn", "empty", "no archive", "a part missing")
        ),
    ],
)
def test_a_broken_checkpoint_gives_way_to_the_one_before(damage, whole, tmp_path, capsys):
    folder = tmp_path / "run"
    training.train(override(PPO, iterations=4), folder, devices=1)
    path = folder / "states" / "4.npz"
    content = path.read_bytes()
    if damage == "torn":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "changed":
        place = content.index(b"NUMPY") + 2000
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    elif damage == "no archive":
        path.write_bytes(b"\x80\x04cos\nsystem\n(S'touch pwned'\ntR." * 10)  # a pickle, never loaded
    else:
        path.unlink()
    training.resume(PPO, folder)
    err = capsys.readouterr().err
    assert "resumes after iteration 2" in err
    assert ("falling back to the previous checkpoint" in err) == (damage != "a part missing")
    assert_same_run(whole(PPO, 1), folder)


def test_nothing_to_go_on_from(whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole(PPO, 1), folder)
    for path in (folder / "states").iterdir():
        path.write_bytes(b"torn")
    with pytest.raises(pecjax.InputError, match=r"6.npz: corrupt .* train anew"):
        training.resume(override(PPO, iterations=8), folder)
    shutil.rmtree(folder / "states")
    with pytest.raises(pecjax.InputError, match="no state to resume from"):
        training.resume(override(PPO, iterations=8), folder)
    with pytest.raises(pecjax.InputError, match="no run here"):
        training.resume(PPO, tmp_path / "nowhere")


def test_a_run_at_its_end_has_nowhere_to_go(whole):
    before = (whole(PPO, 1) / "metrics.csv").read_bytes()
    with pytest.raises(pecjax.InputError, match="already finished at iteration 6"):
        training.resume(PPO, whole(PPO, 1))
    assert (whole(PPO, 1) / "metrics.csv").read_bytes() == before


@pytest.fixture
def ended(whole, tmp_path, monkeypatch):
    """A run at its end; `resume` goes up to its next iteration and returns where the loop would begin."""
    folder = tmp_path / "run"
    shutil.copytree(whole(PPO, 1), folder)
    monkeypatch.setattr(session, "compile_iteration", lambda run: None)
    monkeypatch.setattr(training, "_loop", lambda session, position, *_: position)
    return folder


def write_ratios(folder, ratios):
    """Puts training goal ratios into metrics.csv, as an older or luckier training would have left them."""
    path = folder / "metrics.csv"
    table = pd.read_csv(path, dtype=str)
    table.assign(goal_ratio=ratios).to_csv(path, index=False)


def test_the_streak_of_a_resumed_run_is_that_of_its_new_threshold(ended):
    write_ratios(ended, [0.2, 0.95, 0.5, 0.9, 0.96, 0.97])
    longer = override(PPO, iterations=9)
    for threshold, patience, held in ((0.9, 4, 3), (0.95, 3, 2), (0.99, 1, 0), (0.4, 6, 5), (None, 2, 0)):
        stop = StopSettings(9, threshold, patience)
        found = training.resume(replace(longer, stop=stop), ended)
        assert found.iteration == 6 and found.patience_count == held, threshold
    before = (ended / "config.json").read_bytes()
    for threshold, patience in ((0.9, 3), (0.5, 1)):
        settings = override(longer, until_goal_ratio=threshold, patience=patience)
        with pytest.raises(pecjax.InputError, match=rf"already finished .* {threshold}; .*--patience"):
            training.resume(settings, ended)
    assert (ended / "config.json").read_bytes() == before
    # What was written after the newest checkpoint belongs to no streak.
    with (ended / "metrics.csv").open("a") as file:
        file.write((ended / "metrics.csv").read_text().splitlines()[-1].replace("6,", "7,", 1) + "\n")
    assert training.resume(override(longer, until_goal_ratio=0.96), ended).patience_count == 2


@pytest.mark.parametrize("damage", ["empty", "a cut header", "an empty header"])
def test_a_table_without_a_whole_header_counts_as_absent(damage, ended, capsys):
    path = ended / "metrics.csv"
    text = path.read_text()
    path.write_text({"empty": "", "a cut header": text[:30], "an empty header": "\n" + text}[damage])
    training.resume(override(PPO, iterations=9, until_goal_ratio=0.5), ended)
    assert "metrics.csv: had no whole first line; begins again after iteration 6" in capsys.readouterr().err
    RunDirectory(ended).append("metrics.csv", [{"iteration": 7, "goal_ratio": 0.5}])
    assert pd.read_csv(path).to_dict("list") == {"iteration": [7], "goal_ratio": [0.5]}


def test_a_resumed_run_keeps_what_it_began_with_and_lists_its_sessions(ended, monkeypatch):
    began = json.loads((ended / "config.json").read_text())
    (first,) = began["sessions"]
    assert first["from_iteration"] == 0
    assert datetime.fromisoformat(first["started"]).utcoffset() == timedelta(0)
    facts = {name: began[name] for name in ("versions", "machine", "devices", "git_commit")}
    assert facts.items() <= first.items()
    assert began["files"] == ["scene.xml", "coordinates.csv"]
    monkeypatch.setattr(provenance, "git_commit", lambda: "f00df00d")
    training.resume(override(PPO, iterations=9), ended)
    training.resume(override(PPO, iterations=12), ended, devices=2)
    now = json.loads((ended / "config.json").read_text())
    assert facts.items() <= now.items() and now["files"] == began["files"]
    assert now["settings"]["task"] == began["settings"]["task"]  # by the names that they were given with
    assert now["settings"]["stop"]["iterations"] == 12
    assert now["sessions"][0] == first
    rest = [(s["from_iteration"], s["git_commit"], s["devices"]["used"]) for s in now["sessions"][1:]]
    assert rest == [(6, "f00df00d", 1), (6, "f00df00d", 2)]
    assert RunDirectory(ended).num_devices() == 2  # as many as last time


def test_a_run_of_an_older_version_gets_its_sessions(ended):
    began = json.loads((ended / "config.json").read_text())
    del began["sessions"]
    (ended / "config.json").write_text(json.dumps(began))
    assert RunDirectory(ended).settings() == PPO and RunDirectory(ended).num_devices() == 1
    training.resume(override(PPO, iterations=9), ended)
    first, second = json.loads((ended / "config.json").read_text())["sessions"]
    del began["settings"], began["files"]
    assert first == {"from_iteration": 0, "started": None} | began
    assert second["from_iteration"] == 6 and second["started"]


def test_a_run_that_begins_while_another_looks_at_the_folder_is_left_alone(tmp_path, monkeypatch):
    folder, free = tmp_path / "run", training.check_free

    def look(path):
        free(path)
        RunDirectory(folder).create(replace(PPO, seed=3), 1)

    monkeypatch.setattr(training, "check_free", look)
    with pytest.raises(pecjax.InputError, match="run: holds another run; give another folder"):
        training.train(PPO, folder, devices=1)
    assert RunDirectory(folder).settings().seed == 3
    with alone(tmp_path / "run"), pytest.raises(pecjax.InputError, match="another process trains here"):
        RunDirectory(folder).create(PPO, 1)


def test_tables_of_other_kinds_are_refused_in_one_line(ended):
    settings = override(PPO, iterations=9, until_goal_ratio=0.5)
    (ended / "metrics.csv").write_text("iteration,goal_ratio\n1,0.5\nx,0.5\n2,\n")
    assert training.resume(settings, ended).patience_count == 0
    assert (ended / "metrics.csv").read_text() == "iteration,goal_ratio\n1,0.5\n2,\n"
    (ended / "metrics.csv").write_text("iteration,goal_ratio\n1,high\n")
    with pytest.raises(pecjax.InputError, match=r"metrics.csv: column goal_ratio is damaged"):
        training.resume(settings, ended)
    (ended / "metrics.csv").write_bytes(b"\xff\n1,1\n")
    with pytest.raises(pecjax.InputError, match=r"metrics.csv: has no column iteration"):
        training.resume(settings, ended)


def test_another_run_is_refused_and_the_difference_named(whole, tmp_path, monkeypatch):
    other = override(PPO, alpha=0.5, seed=3, iterations=9)
    with pytest.raises(pecjax.InputError, match=r"alpha \(0.2 there, 0.5 here\), seed \(0 there, 3 here\)"):
        training.resume(other, whole(PPO, 1))
    # A checkpoint that was put into the folder of another run, or into another map.
    for name, content in (("config.json", b'"alpha": 0.7'), ("scene.xml", b"<!-- changed -->\n<mujoco ")):
        folder = tmp_path / name
        shutil.copytree(whole(PPO, 1), folder)
        text = (folder / name).read_bytes()
        old = b'"alpha": 0.2' if name == "config.json" else b"<mujoco "
        (folder / name).write_bytes(text.replace(old, content, 1))
        settings = override(RunDirectory(folder).settings(), iterations=9)
        with pytest.raises(pecjax.InputError, match="alpha" if name == "config.json" else "scene.xml"):
            training.resume(settings, folder)
    # Another version is refused, and where config.json does not name it, by what the state says.
    silent = tmp_path / "silent"
    shutil.copytree(whole(PPO, 1), silent)
    config = json.loads((silent / "config.json").read_text())
    del config["sessions"], config["versions"]
    (silent / "config.json").write_text(json.dumps(config))
    monkeypatch.setattr("importlib.metadata.version", lambda _: "0.0.1")
    for folder, words in (
        (whole(PPO, 1), "run of another"),
        (silent, "6.npz: .* differs in"),
    ):
        with pytest.raises(pecjax.InputError, match=rf"{words} version \('.*' there, '0.0.1' here\)"):
            training.resume(override(PPO, iterations=9), folder)


def test_a_state_of_other_shapes_is_refused(tmp_path):
    path = tmp_path / "1.npz"
    write_arrays(path, {"a": np.zeros(3), "b": np.ones((), np.int32)})
    back = read_arrays(path, {"a": np.empty(3), "b": np.empty((), np.int32)})
    np.testing.assert_array_equal(back["b"], 1)
    for like in (
        {"a": np.empty(4), "b": np.empty((), np.int32)},
        {"a": np.empty(3)},
        {"a": np.empty(3, "f4")},
    ):
        with pytest.raises(pecjax.InputError, match="differs in"):
            read_arrays(path, like)
    np.savez(path, **{"['a']": np.array([{"code": 1}], object)})
    with pytest.raises(CorruptFileError):
        read_arrays(path, {"a": np.empty(1)})


def test_two_trainings_cannot_share_a_folder(whole):
    folder = whole(PPO, 1)
    with alone(folder), pytest.raises(pecjax.InputError, match="another process trains here"):
        training.resume(override(PPO, iterations=9), folder)
    with alone(folder):
        pass  # and is free again


@pytest.mark.slow
@pytest.mark.parametrize("room", [400, 2500, 4000])
def test_a_disk_that_fills_up_is_said_in_one_line_and_nothing_is_lost(room, whole, tmp_path, capsys):
    folder = tmp_path / "run"
    whole(PPO, 1)  # compiled, and the cache written
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    training_error = None
    settings = replace(PPO, configurations_every=1)
    reference = whole(settings, 1)
    try:
        RunDirectory(folder).create(settings, 1)
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))  # no file may grow beyond it
        with pytest.raises(pecjax.InputError, match=r"cannot be written .* --resume") as training_error:
            training._go(settings, RunDirectory(folder), 1, (), is_resumed=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "\n" not in str(training_error.value)
    try:
        training.resume(settings, folder)
    except pecjax.InputError as error:
        assert "no state to resume from" in str(error) and not list(folder.glob("states/[0-9]*"))
    else:
        assert_same_run(reference, folder)


def test_figures_that_are_not_finite_stop_the_run(tmp_path):
    settings = replace(PPO, agent=replace(PPO.agent, learning_rate=1e30))
    with pytest.raises(DivergedError, match=r"at iteration \d+ not finite: .*parameters.*checkpoint"):
        training.train(settings, tmp_path / "run", devices=2)


def test_what_a_run_has_kept_before_it_diverges_is_finite(tmp_path, monkeypatch):
    begin = training.started

    def started(session):
        (state, *rest), iterate = begin(session)
        done = itertools.count(1)

        def spoilt(state):
            state, metrics = iterate(state)
            if next(done) < 3:
                return state, metrics
            params = jax.tree.map(lambda leaf: leaf * np.nan, state.learner.params)
            finite = metrics.finite | {"parameters": np.array(False)}
            learner = state.learner._replace(params=params)
            return state._replace(learner=learner), metrics._replace(finite=finite)

        return loop.Position(state, *rest), spoilt

    monkeypatch.setattr(training, "started", started)
    folder = tmp_path / "run"
    with pytest.raises(
        DivergedError, match=r"at iteration 3 not finite: parameters; iteration 2 is the last"
    ):
        training.train(PPO, folder, devices=1)
    kept = sorted(str(path.relative_to(folder)) for path in folder.rglob("*.npz"))
    assert {"checkpoints/2.npz", "states/2.npz", "episodes/2.npz"} <= set(kept)
    assert not [name for name in kept if name.endswith("/3.npz")]
    for name in kept:
        for part, array in arrays(folder / Path(name).parent, Path(name).name).items():
            assert array.dtype.kind not in "f" or np.isfinite(array).all(), (name, part)


def test_options_beside_resume(whole):
    settings = override(RunDirectory(whole(PPO, 1)).settings(), alpha=0.2, agent="ppo", task="rooms")
    assert settings == PPO


kinds = strategies.sampled_from([np.float32, np.float64, np.int32, np.int64, np.uint8, np.bool_])
leaves = kinds.flatmap(
    lambda kind: arrays_of(kind, array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5))
)


def branches_of(inner):
    return strategies.lists(inner, min_size=1, max_size=3) | strategies.dictionaries(
        strategies.text("ab/.'", max_size=5), inner, min_size=1, max_size=3
    )


trees = leaves | branches_of(leaves | branches_of(leaves))


@settings(deadline=None, derandomize=True, max_examples=100)
@given(trees)
def test_any_tree_of_arrays_reads_back_bit_for_bit(tmp_path_factory, tree):
    path = tmp_path_factory.mktemp("trees") / "tree.npz"
    write_arrays(path, tree)
    back = read_arrays(path, tree)
    assert jax.tree.structure(back) == jax.tree.structure(tree)
    for found, wanted in zip(jax.tree.leaves(back), jax.tree.leaves(tree), strict=True):
        assert found.dtype == wanted.dtype and found.shape == wanted.shape
        assert np.asarray(found).tobytes() == wanted.tobytes()


def test_a_run_with_every_axis_resumes_bit_for_bit(folders):
    """Gusts, camera noise, late actions and the progress of objectives are all in the state."""
    table = write_table(folders / "axes.csv")
    every = replace(PPO, task=replace(PPO.task, table=str(table)))
    world = every.task.make()[1]
    assert all(getattr(world.table, name) is not None for name in axes_of(pecjax.Configurations))
    training.train(every, folders / "every-axis", devices=2)
    training.train(override(every, iterations=4), folders / "every-axis-in-two", devices=2)
    training.resume(every, folders / "every-axis-in-two")
    assert_same_run(folders / "every-axis", folders / "every-axis-in-two")
