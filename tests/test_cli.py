"""The command line: what it prints, what it leaves, and how it refuses."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
from conftest import COMPILED
from test_scene import BAD_MAPS

import pecjax
from pecjax.cli import main
from pecjax.commands import evaluate
from pecjax.envs.rooms import COORDINATE_SET_1, load_coordinates
from pecjax.envs.rooms.scene import default_scene_path
from pecjax.runtime import devices
from pecjax.training import train as training
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import configuration_table

ROOT = Path(__file__).parents[1]
TRAIN = ["train", "--iterations", "2", "--num-envs", "8", "--out", "run"]


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


@pytest.fixture(scope="module", autouse=True)
def cache_of_the_tests():
    """Keeps the user's cache out of it, and the four devices that this process began with."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(COMPILED.parents[1]))
        patch.setattr(devices, "use_all_cores", lambda: None)
        yield


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Uniform sampling over a coordinates file that is gone by the time the run is looked at."""
    folder = tmp_path_factory.mktemp("cli") / "run"
    places = folder.parent / "places.txt"
    places.write_text("-4.5, -1, -3.5, -1\n\n# a comment\n0 0 1 0  # another\n2.0,-3.0,2.75,-6.5\n")
    options = ["--sampler", "uniform", "--coordinates", str(places), "--seed", "5", "--sampled-evaluation"]
    assert main([*TRAIN[:-1], str(folder), *options]) == 0
    places.unlink()
    return folder


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Runs a command that must be refused; returns its one line on stderr."""
    monkeypatch.chdir(tmp_path)

    def attempt(*args):
        before = sorted(tmp_path.rglob("*"))
        assert main([str(arg) for arg in args]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1 and err.endswith("\n") and err.startswith("pecjax: "), err
        assert "Traceback" not in err and len(err) < 1000
        assert sorted(tmp_path.rglob("*")) == before, "something was left behind"
        return err

    return attempt


def test_train_leaves_a_run_and_its_figures(run):
    assert pd.read_csv(run / "metrics.csv").env_steps.tolist() == [256, 512]
    there = {path.suffix for path in (run / "figures").iterdir()}
    assert there == {".pdf", ".png"}
    settings = json.loads((run / "config.json").read_text())["settings"]
    assert settings["stop"]["iterations"] == 2 and settings["agent"]["num_envs"] == 8
    assert settings["seed"] == 5
    assert settings["sampler"] == {"kind": "pecjax.curriculum.uniform:Uniform"}
    assert settings["evaluation"]["greedy"] is False
    assert settings["task"]["table"].endswith("places.txt")


def test_the_uniform_sampler_and_a_coordinates_file(run):
    rows = configuration_table(RunDirectory(run))
    assert rows.config.tolist() == [0, 1, 2] * 2
    np.testing.assert_allclose(rows.probability, 1 / 3, rtol=1e-6)
    metrics = pd.read_csv(run / "metrics.csv")
    assert rows.groupby("iteration").trials.sum().tolist() == metrics.episodes.cumsum().tolist()
    table = load_coordinates(run / "coordinates.csv")
    np.testing.assert_array_equal(table.start, np.float32([[-4.5, -1], [0, 0], [2, -3]]))
    np.testing.assert_array_equal(table.goal, np.float32([[-3.5, -1], [1, 0], [2.75, -6.5]]))


def test_eval_prints_exactly_one_json_object(run, capsys):
    assert main(["eval", str(run), "--episodes", "2", "--sampled", "--json"]) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    report = json.loads(out)
    assert {"goal_ratio", "mean_return", "episodes", "per_configuration"} <= set(report)
    assert report["episodes"] == 2 and report["checkpoint"] == 2 and report["greedy"] is False
    flown = [ratio for ratio in report["per_configuration"] if ratio is not None]
    assert len(report["per_configuration"]) == 3 and len(flown) == 2
    np.testing.assert_allclose(report["goal_ratio"], np.mean(flown), atol=1e-6)
    # In words it says the same.
    assert main(["eval", str(run), "--episodes", "2", "--sampled"]) == 0
    out = capsys.readouterr().out
    assert f"goal ratio {report['goal_ratio']:.4f}" in out and out.count("not flown") == 1


def test_of_many_configurations_eval_lists_the_lowest_that_were_flown(capsys):
    table = jax.tree.map(lambda column: np.resize(column, (100, *column.shape[1:])), COORDINATE_SET_1)
    ratios = np.full(100, np.nan)
    ratios[[3, 50, 99]] = 1.0, 0.5, 0.0
    evaluate._print_configurations(table, ratios)
    title, *lines = capsys.readouterr().out.splitlines()
    assert title == "the 3 lowest of 3 configurations that were flown, of 100:"
    assert [line.split()[0] for line in lines] == ["c99", "c50", "c3"]
    evaluate._print_configurations(table, np.zeros(100))
    assert capsys.readouterr().out.count("\n") == 21


def test_figures_draws_them_again_and_names_them(run, capsys):
    shutil.rmtree(run / "figures")
    assert main(["figures", str(run)]) == 0
    named = capsys.readouterr().out.split()
    assert sorted(named) == sorted(str(path) for path in (run / "figures").iterdir())
    assert len(named) >= 8


@pytest.mark.slow
def test_the_sampler_that_the_docs_show_trains_resumes_and_evaluates(tmp_path, monkeypatch, capsys):
    """It lies in a file beside, and the run knows it by its address."""
    shown = re.search(r"```python\n(# mine\.py.*?)```", (ROOT / "docs/own-sampler.md").read_text(), re.DOTALL)
    (tmp_path / "mine.py").write_text(shown[1])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    assert main([*TRAIN[:-3], "8", "--out", "run", "--sampler", "mine:Learnability"]) == 0
    config = json.loads(Path("run/config.json").read_text())
    assert config["settings"]["sampler"] == {"kind": "mine:Learnability", "floor": 0.05}
    rows = configuration_table(RunDirectory(Path("run")))
    rows = rows[rows.iteration == 2]
    p = rows.failures / rows.trials.clip(lower=1)
    weight = np.where(rows.trials > 0, p * (1 - p) + 0.05, 1)
    np.testing.assert_allclose(rows.probability, weight / weight.sum(), rtol=2e-6)
    assert main(["train", "--resume", "--out", "run", "--iterations", "3"]) == 0
    assert pd.read_csv("run/metrics.csv").iteration.tolist() == [1, 2, 3]
    assert main(["eval", "run", "--episodes", "2"]) == 0
    # Where it is not to be found, the run says so.
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    monkeypatch.delitem(sys.modules, "mine")
    capsys.readouterr()
    assert main(["eval", "../run"]) == 2
    assert "../run/config.json: mine:Learnability: cannot be imported" in capsys.readouterr().err


@pytest.mark.slow
def test_a_folder_of_maps_is_checked_flown_kept_and_drawn(edited_rooms, tmp_path, monkeypatch, capsys):
    """The second of them lacks a wall, and both are gone by the time the run is looked at."""
    monkeypatch.chdir(tmp_path)
    text = default_scene_path().read_text()
    wall = next(line for line in text.splitlines() if 'name="west_b"' in line)
    Path("maps").mkdir()
    Path("maps/a.xml").write_text(text)
    Path("maps/b.xml").write_text(text.replace(wall, ""))
    Path("pairs.csv").write_text("start_x start_y goal_x goal_y map\n0 0 1 0 1\n0 -2 0.7 -2 0\n0 0 1 0 0\n")
    world = ["--scene", "maps", "--coordinates", "pairs.csv"]
    assert main(["check", *world, "--out", "map"]) == 0
    assert capsys.readouterr().out.startswith("2 maps, the first of 14 walls, 3 configurations: every one")
    assert main([*TRAIN, *world]) == 0
    assert {path.name for path in Path("run/maps").iterdir()} == {"0.xml", "1.xml"}
    shutil.rmtree("maps")
    capsys.readouterr()
    assert main(["eval", "run", "--episodes", "6"]) == 0
    assert re.findall(r"^  c\d .* in map (\d)", capsys.readouterr().out, re.MULTILINE) == ["1", "0", "0"]
    assert main(["figures", "run"]) == 0 and "run/figures/map.png" in capsys.readouterr().out
    assert main(["train", "--resume", "--out", "run", "--iterations", "3"]) == 0
    Path("run/maps/1.xml").unlink()
    assert main(["eval", "run"]) == 2
    assert "configuration 0: there is no map 1; the maps are 0 to 0" in capsys.readouterr().err


def test_a_task_of_ones_own_trains_resumes_evaluates_and_is_drawn(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "examples")])
    own = ["--task", "own_task:PuckSettings"]
    assert main([*TRAIN, *own, "--task.number", "3", "--evaluation.episodes", "6"]) == 0
    settings = json.loads(Path("run/config.json").read_text())["settings"]
    assert settings["task"] == {"kind": "own_task:PuckSettings", "number": 3}
    assert "effort" in pd.read_csv("run/metrics.csv") and "effort" in pd.read_csv("run/evaluation.csv")
    assert main(["train", "--resume", "--out", "run", "--iterations", "3"]) == 0
    # It has nothing that could be drawn on a map.
    drawn = {path.stem for path in Path("run/figures").iterdir()}
    assert drawn == {"goal_ratio", "configurations", "spread", "evaluation"}
    capsys.readouterr()
    assert main(["eval", "run", "--episodes", "6"]) == 0
    out = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert out[1][:2] == ["all", "6"]
    assert [line[:2] for line in out[2:]] == [["c0", "0"], ["c1", "1"], ["c2", "2"]]
    assert main(["eval", "run", "--space", "rooms-pairs"]) == 2
    assert "a task without spaces or maps" in capsys.readouterr().err
    assert main([*TRAIN[:-1], "other", *own, "--coordinates", "2"]) == 2
    assert "the task own_task:PuckSettings has no table; leave out --coordinates" in capsys.readouterr().err
    assert main(["train", *own, "--agent", "apex", "--out", "other"]) == 2
    assert "apex needs discrete actions" in capsys.readouterr().err
    assert not Path("other").exists()


@pytest.mark.parametrize("coordinates", ["1", "2"])
def test_check_passes_the_papers_sets_and_draws_them(coordinates, tmp_path, capsys):
    assert main(["check", "--coordinates", coordinates, "--out", str(tmp_path / "map")]) == 0
    size = (pecjax.COORDINATE_SET_1 if coordinates == "1" else pecjax.COORDINATE_SET_2).size
    assert f"{size} configurations" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {"map.pdf", "map.png"}
    assert min(path.stat().st_size for path in tmp_path.iterdir()) > 5000


def test_check_draws_to_the_name_it_is_given(tmp_path):
    assert main(["check", "--out", str(tmp_path / "map.v2")]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"map.v2.pdf", "map.v2.png"}


@pytest.mark.parametrize("command", [[], ["train"], ["eval"], ["figures"], ["check"]])
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    out, err = capsys.readouterr()
    assert "usage: pecjax" in out and err == ""
    words = {"": ["watch demo", "new-map"], "train": ["--preset", "--alpha", "--seed"]}
    words |= {"eval": ["--json", "--seed"], "check": ["--scene"]}
    for word in words.get("".join(command), []):
        assert word in out


@pytest.mark.parametrize("module", ["pecjax", "pecjax.cli"])
def test_as_a_process_of_its_own(module, tmp_path):
    command = [sys.executable, "-m", module, "check", "--scene", "nowhere.xml"]
    refused = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=120)
    assert refused.returncode == 2 and refused.stdout == ""
    assert refused.stderr == "pecjax: nowhere.xml: no such scene file; give the path of an MJCF file\n"
    assert not os.listdir(tmp_path)


# Bad scenes: pieces of rooms.xml replaced, and what the complaint must say.
CAMERA = '<camera name="depth" pos="0.1 0 0" xyaxes="0 -1 0 0 0 1" fovy="73.7398" resolution="16 12"/>'
SCENES = {
    "no drone": (('<body name="drone"', '<body name="bird"'), "no body named 'drone'"),
    "no camera": ((CAMERA, ""), "no camera on the body 'drone'"),
    "a round wall": (
        ('name="west_b"', 'name="west_b" type="cylinder"'),
        "'west_b' collides and is a cylinder",
    ),
    "a turned wall": (
        ('name="north_b"', 'name="north_b" euler="0 0 0.3"'),
        "'north_b' collides and is turned",
    ),
}


@pytest.mark.parametrize("command", [TRAIN, ["check"]], ids=["train", "check"])
@pytest.mark.parametrize("name", SCENES)
def test_bad_scenes(name, command, edited_rooms, refused):
    replacement, words = SCENES[name]
    path = edited_rooms(replacement)
    complaint = refused(*command, "--scene", path)
    assert words in complaint and str(path) in complaint


@pytest.mark.parametrize("command", [TRAIN, ["check"]], ids=["train", "check"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such scene file"),
        (b"just words", "not XML"),
        (b"\xff\xfe\x00\x01", "not XML"),
        (b"", "not XML"),
        (b"<html/>", "MuJoCo cannot compile it"),
        (b"<mujoco/>", "no wall; the map needs at least one box"),
    ],
)
def test_scene_files_that_are_none(content, words, command, tmp_path, refused):
    if content is not None:
        (tmp_path / "map.xml").write_bytes(content)
    complaint = refused(*command, "--scene", "map.xml")
    assert words in complaint and "map.xml" in complaint


@pytest.mark.parametrize("command", [TRAIN, ["check"]], ids=["train", "check"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "neither 1 nor 2 nor a file"),
        (b"", "no configurations"),
        (b"# only words\n\n", "no configurations"),
        (b"0 0 1 0\none two three four\n", "line 2: 'one two three four' is not 4 numbers"),
        (b"0 0 1\n", "line 1: '0 0 1' is not 4 numbers"),
        (b"0 0 1 0 5\n", "line 1"),
        (b"0 0 nan 0\n", "line 1"),
        (b"0 0 inf 0\n", "line 1"),
        (b"\xff\xfe\x00", "cannot be read as text"),
        (b"start_x,start_y,x,y\n0 0 1 0\n", "places.txt, line 1, column 3: 'x' is unknown"),
        (b"0 0 1 0\n0 1 2 0\n", "places.txt, line 2: configuration 1: start (0, 1) lies inside a wall"),
        (b"0 0 5 0.8\n", "configuration 0: goal (5, 0.8) lies 0.10 m from a wall"),
        (b"0 0 1 0\n\n0 0 20 0\n", "configuration 1: goal (20, 0) lies outside the map"),
        (b"2 -1 2 -1\n", "configuration 0: start and goal are both (2, -1)"),
    ],
)
def test_bad_coordinate_files(content, words, command, tmp_path, refused):
    if content is not None:
        (tmp_path / "places.txt").write_bytes(content)
    assert words in refused(*command, "--coordinates", "places.txt")


@pytest.mark.parametrize("case", [*BAD_MAPS, "the timestep does not divide a control period"])
def test_check_and_train_say_the_same_of_a_bad_map(case, edited_rooms, refused):
    edits = BAD_MAPS[case][0] if case in BAD_MAPS else [('timestep="0.02"', 'timestep="0.03"')]
    path = edited_rooms(*edits)
    assert refused("check", "--scene", path) == refused(*TRAIN, "--scene", path)


def test_check_and_train_accept_the_same_maps(other_map, edited_rooms, tmp_path, monkeypatch, capsys):
    """And what is trained on is the map that was checked."""
    mesh = '<asset><mesh name="hat" file="hat.obj"/></asset><worldbody>'
    shown = edited_rooms(("<worldbody>", f'{mesh}<geom type="mesh" mesh="hat" contype="0" conaffinity="0"/>'))
    floor = edited_rooms(("<light", '<geom type="plane" size="9 9 1"/><light'))
    flown = []

    def go(settings, directory, *_, **__):
        (scene,) = settings.task.kept_in(directory.folder).scenes()
        flown.append(scene)
        return {"uniform_evaluation": {"goal_ratio": 1.0, "episodes": 1, "greedy": True}} | dict.fromkeys(
            ("env_steps", "seconds", "compile_seconds"), 0
        )

    monkeypatch.setattr(training, "_go", go)
    monkeypatch.setattr("pecjax.commands.train.draw", lambda _: None)
    monkeypatch.setattr("pecjax.commands.check.draw_map", lambda scene, *_: flown.append(scene) or [])
    (tmp_path / "pairs.csv").write_text("0,-2,-2,-2\n")
    for number, path in enumerate((other_map, shown, floor, default_scene_path())):
        world = ["--scene", str(path), "--coordinates", str(tmp_path / "pairs.csv")]
        assert main(["check", *world]) == 0
        assert main([*TRAIN[:-1], str(tmp_path / f"run{number}"), *world]) == 0
        checked, trained = flown[-2:]
        for name in ("lower", "upper", "bounds"):
            np.testing.assert_array_equal(getattr(checked.map, name), getattr(trained.map, name))
        for name in ("mass", "inertia", "radius"):
            np.testing.assert_array_equal(getattr(checked.vehicle, name), getattr(trained.vehicle, name))
        cameras = checked.vehicle.camera, trained.vehicle.camera
        np.testing.assert_array_equal(*(camera.rotation for camera in cameras))
    assert capsys.readouterr().err == ""


def test_notices_of_a_map_are_printed_by_check(edited_rooms, tmp_path, capsys):
    path = edited_rooms(('timestep="0.02" ', ""))
    assert main(["check", "--scene", str(path), "--out", str(tmp_path / "map")]) == 0
    out, err = capsys.readouterr()
    assert "14 walls" in out
    assert err.startswith("pecjax: notice: the map's timestep is 0.002 s") and err.count("\n") == 1


@pytest.mark.parametrize("command", [TRAIN, ["check"]], ids=["train", "check"])
def test_a_goal_that_no_path_reaches(command, edited_rooms, refused):
    # One wall right across closes the door between the hall and the south-east.
    closed = edited_rooms(('pos="-4 -4 1.25" size="6 0.1 1.25"', 'pos="-1 -4 1.25" size="9 0.1 1.25"'))
    complaint = refused(*command, "--scene", closed)
    assert "configuration 14: no path" in complaint and "(3, -5) to (3, -2)" in complaint


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--alpha", "-0.1"], ["alpha", "-0.1"]),
        (["--alpha", "nan"], ["alpha", "nan"]),
        (["--alpha", "inf"], ["alpha", "inf"]),
        (["--alpha", "1e39"], ["alpha"]),  # infinite in float32
        (["--sampler", "bandit"], ["unknown sampler 'bandit'", "pec", "uniform"]),
        (["--preset", "slow"], ["unknown preset 'slow'", "fast", "rllib085"]),
        (["--coordinates", "3"], ["'3'"]),
        (["--task", "room"], ["unknown task 'room' (did you mean rooms?)"]),
        (["--agent", "no.such:Agent"], ["no.such:Agent: cannot be imported"]),
        (["--scene", "."], ["no MJCF file (*.xml) in this folder"]),
        (["--scene"], ["--scene has no value; give one or leave it out"]),
        (["--algorithm", "apex"], ["unknown option --algorithm"]),
        (["--agent", "sac"], ["unknown agent 'sac'", "ppo", "apex"]),
        (["--agent", "apex", "--preset", "rllib085"], ["preset 'rllib085' trains with ppo"]),
        (["--agent", "apex", "--num-envs", "6"], ["4 shards do not divide 6 environments"]),
        (
            ["--agent", "apex", "--num-envs", "512", "--devices", "3"],
            ["4 replay shards cannot be shared evenly by", "3 devices"],
        ),
        (["--agent", "apex", "--num-envs", "512", "--sampler", "plr"], ["signal is None", "PPO gives it"]),
        (["--until-goal-ratio", "1.5"], ["until-goal-ratio is 1.5"]),
        (["--until-goal-ratio", "nan"], ["until-goal-ratio is nan"]),
        (["--patience", "0"], ["patience is 0"]),
        (["--num-envs", "0"], ["num-envs is 0"]),
        (["--num-envs", "-8"], ["num-envs is -8"]),
        (["--iterations", "0"], ["iterations is 0"]),
        (["--iterations", "-1"], ["iterations is -1"]),
        (["--devices", "0"], ["devices is 0"]),
        (["--devices", "-1"], ["devices is -1"]),
        (["--devices", "5"], ["devices is 5", "has 4"]),
        (["--devices", "2", "--num-envs", "7"], ["7 environments", "2 devices"]),
        (["--seed", "-1"], ["seed is -1"]),
        (["--seed", "99999999999"], ["seed is 99999999999"]),
        (["--speed", "3"], ["unknown option --speed"]),
        (["--itterations", "3"], ["unknown option --itterations (did you mean --iterations?)"]),
        (["--num-envz=8"], ["(did you mean --num-envs?)"]),
        (["--sampler", "uniform", "--alpha", "0.5"], ["the sampler uniform has no alpha", "leave out"]),
        (["run2"], ["unexpected 'run2'"]),
        (["--alpha", "β"], ["--alpha takes a number, not 'β'; pecjax train --help lists all options\n"]),
        (["--iterations", "many"], ["--iterations", "many"]),
        (["--alpha", "big"], ["--alpha", "big"]),
        (["--seed", "1.5"], ["--seed", "1.5"]),
        (["--out"], ["--out"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_bad_options_of_train(options, words, refused):
    complaint = refused(*TRAIN, *options)
    for word in words:
        assert word in complaint


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["fig5"], ["unknown study 'fig5'", "fig4", "fig14"]),
        (["fig4", "--scale", "huge"], ["unknown scale 'huge' of fig4", "smoke"]),
        (["--scale", "smoke"], ["scale is of named studies"]),
        (["fig14", "--preset", "rllib085"], ["rllib085 is of ppo and fig14 of apex"]),
        (["--preset", "slow"], ["unknown preset 'slow'"]),
        (["samplers-storm"], ["unknown study 'samplers-storm' (did you mean samplers-rooms-storm?)"]),
        (["samplers", "--scale", "paper"], ["unknown scale 'paper'", "full"]),
        (["samplers-tasks", "--scale", "screening"], ["unknown scale 'screening' of samplers-tasks"]),
        (["samplers", "--preset", "fast"], ["settings of its own; leave out --preset"]),
        (["report"], ["studies/samplers-laptop: neither study.json nor CELL/results.csv", "rooms-pairs"]),
        (["--samplers", "pec", "bandit"], ["unknown sampler 'bandit'"]),
        (["--samplers"], ["--samplers has no value"]),
        (["--seeds"], ["--seeds has no value"]),
        (["--alphas"], ["--alphas has no value"]),
        (["--alphas", "0", "-1"], ["alpha is -1"]),
        (["--samplers", "uniform", "--alphas", "0.2", "0.5"], ["uniform has no alpha", "leave out --alphas"]),
        (["--alhpas", "0.2"], ["(did you mean --alphas?)"]),
        (["--alphas", "x"], ["--alphas takes numbers, not 'x'"]),
        (["--seeds", "0-"], ["seeds: '0-' is neither"]),
        (["--seeds", "9-0"], ["'9-0' must rise"]),
        (["--seeds", "0-4", "3"], ["seeds names 3 more than once"]),
        (["--parallel-runs", "0"], ["parallel-runs is 0"]),
        (["--out", "file"], ["file: is a file"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_bad_options_of_study(options, words, refused, tmp_path):
    (tmp_path / "file").write_text("")
    complaint = refused("study", *options)
    for word in words:
        assert word in complaint


def test_no_command_and_an_unknown_one(refused):
    assert "no command; give one of train, eval" in refused()
    assert "unknown command 'fly'; give one of train, eval" in refused("fly")
    assert "unknown command 'trian' (did you mean train?)" in refused("trian", "--seed", "3")
    assert "(did you mean --version?)" in refused("--verison")


@pytest.mark.parametrize("columns", ["40", "200"])
def test_complaints_are_the_same_on_every_terminal(columns, refused, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    line = "unknown option --alhpa (did you mean --alpha?); pecjax train --help lists all options"
    assert refused("train", "--alhpa", "3") == f"pecjax: {line}\n"


def test_the_version(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0 and capsys.readouterr() == (f"pecjax {pecjax.__version__}\n", "")


@pytest.mark.parametrize("command", ["train", "study", "check", "eval"])
def test_help_names_each_default_once_and_no_types_of_python(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    words = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "(default: None)" not in words and "{None}" not in words and ") (default" not in words


def test_a_reader_that_has_had_enough_is_no_fault():
    """As in `pecjax eval RUN | head -1`."""
    command = [sys.executable, "-m", "pecjax", "train", "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b"" and process.wait(60) == 141


def test_out_folders_that_cannot_be_had(tmp_path, refused):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "config.json").write_text("{}")
    (tmp_path / "file").write_text("")
    for out, words in (
        ("taken", "taken: holds another run"),
        ("file", "file: is a file"),
        ("file/run", "file/run"),
        ("/proc/run", "/proc/run"),
    ):
        assert words in refused(*TRAIN[:-1], out)
    for out in ("file/map", "/proc/map"):
        assert out in refused("check", "--out", out)


def test_figures_that_cannot_be_written(tmp_path, run, refused):
    shutil.copytree(run, tmp_path / "copy")
    shutil.rmtree(tmp_path / "copy" / "figures")
    (tmp_path / "copy" / "figures").write_text("")  # stands where the folder would
    assert "figures/goal_ratio: cannot be written" in refused("figures", "copy")


@pytest.mark.parametrize("command", ["eval", "figures"])
def test_folders_that_hold_no_run(command, tmp_path, refused):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    for folder in ("nowhere", "empty", "file"):
        assert f"{folder}: no run here" in refused(command, folder)


@pytest.mark.parametrize("command", ["eval", "figures"])
@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"settings": 3}', '{"settings": {"alpha": "x"}}'])
def test_a_corrupt_config(command, content, tmp_path, run, refused):
    shutil.copytree(run, tmp_path / "copy")
    (tmp_path / "copy" / "config.json").write_text(content)
    assert "config.json" in refused(command, "copy")


def test_evaluations_that_cannot_be_flown(run, tmp_path, refused):
    assert "no checkpoint 3; there are 2" in refused("eval", run, "--checkpoint", "3")
    assert "episodes is 0" in refused("eval", run, "--episodes", "0")
    assert "episodes is -2" in refused("eval", run, "--episodes", "-2")
    refused("eval")
    assert "seed is -1" in refused("eval", run, "--seed", "-1")


@pytest.mark.parametrize(
    ("command", "lost"),
    [
        ("eval", "checkpoints"),
        ("eval", "scene.xml"),
        ("eval", "coordinates.csv"),
        ("figures", "metrics.csv"),
        ("figures", "evaluation.csv"),
        ("figures", "episodes"),
        ("figures", "configurations"),
        ("figures", "scene.xml"),
        ("figures", "coordinates.csv"),
    ],
)
def test_a_run_that_has_lost_a_part(command, lost, run, tmp_path, refused):
    shutil.copytree(run, tmp_path / "copy")
    path = tmp_path / "copy" / lost
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert lost in refused(command, "copy")


@pytest.mark.parametrize("content", ["", "not,a\ntable"])
def test_figures_of_a_spoilt_table(content, run, tmp_path, refused):
    shutil.copytree(run, tmp_path / "copy")
    (tmp_path / "copy" / "metrics.csv").write_text(content)
    assert "metrics.csv" in refused("figures", "copy")
