"""`pecjax watch` and the demos, from the command line."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pecjax
from pecjax.cli import main
from pecjax.training.demos import DEMOS, find_run
from pecjax.training.run_arrays import last_recording
from pecjax.training.run_directory import RunDirectory
from pecjax.viewing.movie import followed
from pecjax.viewing.recording import read_recording


@pytest.fixture(autouse=True)
def empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_page_of_a_demo_is_written_where_one_is(empty_folder, capsys):
    assert main(["watch", "demo", "--no-open"]) == 0
    assert capsys.readouterr().out == "demo.html: 50 flights; open it in a browser\n"
    assert [path.name for path in empty_folder.iterdir()] == ["demo.html"]
    assert (empty_folder / "demo.html").stat().st_size < 5e6


@pytest.mark.parametrize("demo", DEMOS)
def test_demos_hold_what_is_watched_and_small_weights(demo):
    run = RunDirectory(find_run(Path(demo)))
    with last_recording(run) as arrays:
        assert arrays["success"].mean() >= 0.95
        assert len(arrays["recorded"]) == 50
    (checkpoint,) = (run.folder / "checkpoints").glob("*.npz")
    assert str(pecjax.open_run(demo).iteration) == checkpoint.stem
    with np.load(checkpoint) as arrays:
        assert sum(arrays[name].nbytes for name in arrays.files if name.startswith(".params")) < 200_000
        rest = [arrays[name] for name in arrays.files if name.startswith(".optimizer")]
        assert not any(array.any() for array in rest)  # nothing, in a compressed wheel


def test_a_demo_is_exported_to_where_one_is(empty_folder, capsys):
    pytest.importorskip("onnx")
    assert main(["export", "demo-set-2"]) == 0
    assert capsys.readouterr().out == "policy.onnx\npolicy.json\n"
    assert sorted(path.name for path in empty_folder.iterdir()) == ["policy.json", "policy.onnx"]


def test_a_folder_called_demo_comes_first(empty_folder, capsys):
    (empty_folder / "demo").mkdir()
    assert main(["watch", "demo", "--no-open"]) == 2
    assert "demo: no run here" in capsys.readouterr().err


def test_a_gif_has_a_frame_for_each_step(empty_folder, capsys):
    assert main(["watch", "demo-set-1", "--flights", "2", "--gif", "flights.gif"]) == 0
    recording, _ = read_recording(find_run(Path("demo-set-1")), 2)
    with Image.open(empty_folder / "flights.gif") as movie:
        assert movie.n_frames == len(followed(recording).poses)
        assert movie.info["duration"] == 100
        first = movie.convert("RGB").tobytes()
        movie.seek(movie.n_frames - 1)
        assert first != movie.convert("RGB").tobytes()


@pytest.mark.slow
def test_an_mp4_has_a_frame_for_each_step_and_a_pause(empty_folder):
    av = pytest.importorskip("av")
    assert main(["watch", "demo-set-1", "--flights", "2", "--mp4", "flights.mp4"]) == 0
    recording, _ = read_recording(find_run(Path("demo-set-1")), 2)
    with av.open("flights.mp4") as movie:
        stream = movie.streams.video[0]
        assert stream.average_rate == 10
        assert sum(1 for _ in movie.decode(stream)) == len(followed(recording).poses) + 10


@pytest.mark.slow
@pytest.mark.parametrize("opengl", ["osmesa", "disabled"])
def test_mujoco_draws_where_there_is_opengl(opengl, empty_folder):
    watch = ["watch", "demo-set-1", "--flights", "2", "--gif", "flights.gif", "--renderer", "mujoco"]
    env = {**os.environ, "MUJOCO_GL": opengl}
    done = subprocess.run([sys.executable, "-m", "pecjax", *watch], env=env, capture_output=True, text=True)
    if done.returncode == 2 or opengl == "disabled":
        assert done.returncode == 2 and "MuJoCo cannot draw here (no OpenGL)" in done.stderr
        assert not [*empty_folder.iterdir()]
        if opengl != "disabled":
            pytest.skip("no OSMesa here, which no package of Python brings along; see docs/watching.md")
        return
    assert done.returncode == 0, done.stderr
    recording, _ = read_recording(find_run(Path("demo-set-1")), 2)
    flight = followed(recording)
    with Image.open("flights.gif") as movie:
        assert movie.n_frames == len(flight.poses)
        movie.seek(movie.n_frames - 1)
        last = np.asarray(movie.convert("L"), float)
    seen = last[16 : 16 + 13 * 12 : 13, -10 - 13 * 16 + 6 : -10 : 13]
    expected = 255 * (1 - flight.depth[-1] / recording.task.vehicle.camera.far)
    assert np.abs(seen - expected).max() < 24  # a GIF has few shades


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--flights", "0"], "flights is 0; give 1 or more"),
        (["--out", "page.txt"], "page.txt: give a name that ends in .html"),
        (["--gif", "movie.mp4"], "movie.mp4: give a name that ends in .gif"),
        (["--gif", "a.gif", "--out", "b.html"], "leave one out"),
        (["--renderer", "opengl"], "--renderer"),
        (["--checkpoint", "3"], "no checkpoint 3; there are 457"),
    ],
)
def test_mistakes_get_one_line_and_leave_nothing(options, words, empty_folder, capsys):
    assert main(["watch", "demo-set-1", "--no-open", *options]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not [*empty_folder.iterdir()]


def test_a_page_that_cannot_be_written_gets_one_line(empty_folder, capsys):
    (empty_folder / "taken").write_text("a file")
    assert main(["watch", "demo-set-1", "--no-open", "--flights", "1", "--out", "taken/page.html"]) == 2
    assert "taken/page.html: cannot be written" in capsys.readouterr().err
    assert [path.name for path in empty_folder.iterdir()] == ["taken"]


@pytest.mark.slow
def test_new_flights_can_be_watched_and_demos_evaluated(empty_folder, capsys):
    assert main(["watch", "demo-set-1", "--no-open", "--coordinates", "2", "--episodes", "8"]) == 0
    assert "8 flights" in capsys.readouterr().out
    assert main(["eval", "demo-set-1", "--episodes", "40"]) == 0
    assert "over 40 greedy episodes" in capsys.readouterr().out
