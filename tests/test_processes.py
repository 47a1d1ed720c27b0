"""Real processes: several that share a training train as one would, and end together."""

import functools
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import pecjax
from pecjax import cli
from pecjax.runtime import distributed as processes
from pecjax.studies.catalogue import find_study
from pecjax.training import train as training
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import configuration_table
from pecjax.training.settings import override

pytestmark = pytest.mark.slow

DEVICES_EACH = 2
TRAIN = """
import sys
from dataclasses import replace
from pathlib import Path

import jax

from pecjax import cli
from pecjax.runtime import devices
from pecjax.training import presets
from pecjax.studies import catalogue as studies

index, port, cache, *args = sys.argv[1:]
jax.config.update("jax_compilation_cache_dir", cache)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
devices.use_all_cores = lambda: jax.config.update("jax_num_cpu_devices", 2)
devices.keep_compiled_programs = lambda: None
for preset, study in (("fast", "fig4"), ("apex-fast", "fig14")):
    smoke = studies.find_study(study, "smoke").run
    evaluation = replace(smoke.evaluation, episodes=6)
    presets.PRESETS[preset] = replace(smoke, evaluation=evaluation, configurations_every=3)
if index != "alone":
    args += ["--coordinator", f"localhost:{port}", "--num-processes", "2", "--process-id", index]
sys.exit(cli.main(["train", *args]))
"""
SMOKE = {agent: find_study(study, "smoke").run for agent, study in (("ppo", "fig4"), ("apex", "fig14"))}
SETTINGS = {
    agent: replace(run, evaluation=replace(run.evaluation, episodes=6), configurations_every=3)
    for agent, run in SMOKE.items()
}
SECONDS_TO_NOTICE = 60


def free_port():
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


class One:
    """One of several processes; what it says goes to files, for a pipe that nobody empties holds it up."""

    def __init__(self, command, place):
        self.out, self.err = place.with_suffix(".out"), place.with_suffix(".err")
        with self.out.open("w") as out, self.err.open("w") as err:
            self.process = subprocess.Popen(command, stdout=out, stderr=err)

    def exit_code(self, seconds):
        return self.process.wait(timeout=seconds)

    def lines(self):
        """Its own, without those that XLA and JAX write to the log."""
        return [line for line in self.err.read_text().splitlines() if line.startswith("pecjax: ")]

    def only_line(self):
        """What it says at its end; the guard's word may come a moment after."""
        deadline = time.monotonic() + 30
        while not self.lines() and time.monotonic() < deadline:
            time.sleep(0.1)
        (line,) = self.lines()
        return line


@pytest.fixture
def start(folders, tmp_path):
    """(arguments of each) -> the processes, which do not outlive the test."""
    started = []

    def start(*args):
        port = free_port()
        for index, own in enumerate(args):
            name = str(index) if len(args) > 1 else "alone"
            command = [sys.executable, "-c", TRAIN, name, str(port), str(folders / "compiled"), *own]
            started.append(One(command, tmp_path / f"process-{len(started)}"))
        return started[-len(args) :]

    yield start
    for one in started:
        one.process.kill()
        one.process.wait()


def exit_codes(both, seconds=300):
    return [one.exit_code(seconds) for one in both]


def wait_for(pattern, folder, both):
    deadline = time.monotonic() + 240
    while not list(folder.glob(pattern)):
        assert time.monotonic() < deadline and all(one.process.poll() is None for one in both)
        time.sleep(0.05)


@pytest.fixture(scope="module")
def alone(folders):
    """(agent) -> the folder of the same training in this process, on as many devices."""

    @functools.cache
    def alone(agent):
        training.train(override(SETTINGS[agent], iterations=4), folders / agent, devices=4)
        return folders / agent

    return alone


def assert_as_alone(folder, alone):
    read = {f: {name: pd.read_csv(f / f"{name}.csv") for name in TABLES} for f in (folder, alone)}
    for name in TABLES:
        drop = ["seconds"] if name == "metrics" else []
        found, wanted = (read[f][name].drop(columns=drop) for f in (folder, alone))
        pd.testing.assert_frame_equal(found, wanted, rtol=2e-4, atol=1e-5)
    counts = ["iteration", "config", "trials", "failures"]
    found, wanted = (configuration_table(RunDirectory(f)) for f in (folder, alone))
    assert found[counts].equals(wanted[counts]) and wanted.iteration.unique().tolist() == [1, 3, 4]
    np.testing.assert_allclose(found.probability, wanted.probability, rtol=1e-6)
    for path in sorted(alone.rglob("*.npz")):
        with np.load(path) as wanted, np.load(folder / path.relative_to(alone)) as found:
            assert found.files == wanted.files
            for name in set(wanted.files) - {".seconds", "about"}:
                assert found[name].shape == wanted[name].shape, (path, name)
                if ".learner.params" in name:
                    np.testing.assert_allclose(found[name], wanted[name], rtol=1e-3, atol=1e-5)


TABLES = ("metrics", "evaluation")


@pytest.mark.parametrize("agent", SETTINGS)
def test_two_processes_train_as_one(agent, start, alone, tmp_path):
    """And resume together where they stopped."""
    folder = tmp_path / "run"
    args = ["--agent", agent, "--iterations", "2", "--out", str(folder)]
    assert exit_codes(start(args, args)) == [0, 0]
    args = ["--iterations", "4", "--out", str(folder), "--resume"]
    both = start(args, args)
    assert exit_codes(both) == [0, 0]
    assert "goal ratio" in both[0].out.read_text()
    assert "goal ratio" not in both[1].out.read_text() + both[1].err.read_text()  # the first prints
    assert_as_alone(folder, alone(agent))
    assert len(list((folder / "figures").glob("*.png"))) == 5


@pytest.mark.parametrize("struck", [0, 1])
def test_a_process_that_dies_ends_the_others_and_the_run_goes_on(struck, start, alone, tmp_path):
    folder = tmp_path / "run"
    args = ["--iterations", "100000", "--out", str(folder)]
    both = start(args, args)
    wait_for("states/[0-9]*.npz", folder, both)
    both[struck].process.kill()
    assert both[1 - struck].exit_code(SECONDS_TO_NOTICE) != 0
    line = both[1 - struck].only_line()
    assert processes.LOST in line and f"pecjax train --resume --out {folder}" in line
    # What is there is whole: this process alone resumes from it, on as many devices.
    done = max(int(path.stem) for path in folder.glob("states/[0-9]*.npz"))
    last = max(done + 1, 4)
    training.resume(override(SETTINGS["ppo"], iterations=last), folder)
    metrics = pd.read_csv(folder / "metrics.csv")
    assert metrics.iteration.tolist() == list(range(1, last + 1))
    found, wanted = (
        table.drop(columns="seconds")[:4] for table in (metrics, pd.read_csv(alone("ppo") / "metrics.csv"))
    )
    pd.testing.assert_frame_equal(found, wanted, rtol=2e-4, atol=1e-5)


def test_a_signal_to_one_stops_both_after_the_same_iteration(start, tmp_path):
    folder = tmp_path / "run"
    args = ["--iterations", "100000", "--out", str(folder)]
    both = start(args, args)
    wait_for("evaluation.csv", folder, both)
    both[1].process.send_signal(signal.SIGTERM)
    assert exit_codes(both, 120) == [143, 143]
    (line,) = both[0].lines()
    done = max(int(path.stem) for path in folder.glob("states/[0-9]*.npz"))
    assert both[1].lines() == [line] and f"stopped after iteration {done};" in line
    assert pd.read_csv(folder / "metrics.csv").iteration.tolist() == list(range(1, done + 1))


def test_ctrl_c_ends_a_process_that_is_alone_with_130(start, tmp_path):
    folder = tmp_path / "run"
    started = start(["--iterations", "100000", "--out", str(folder)])
    wait_for("evaluation.csv", folder, started)
    started[0].process.send_signal(signal.SIGINT)
    assert exit_codes(started, 120) == [130]
    assert f"resume with pecjax train --resume --out {folder}" in started[0].only_line()


@pytest.mark.parametrize(
    ("args", "lines"),
    [
        ((["--seed", "1"], ["--seed", "2"]), ["settings that differ"] * 2),
        ((["--coordinates", "1"], ["--coordinates", "2"]), ["settings that differ"] * 2),
        ((["--alpha", "0.1"], ["--alpha", "-1"]), ["another process could not start", "alpha is -1"]),
    ],
)
def test_processes_that_cannot_begin_together(args, lines, start, tmp_path):
    folder = tmp_path / "run"
    both = start(*([*own, "--out", str(folder)] for own in args))
    assert exit_codes(both) == [2, 2]
    for one, words in zip(both, lines, strict=True):
        assert words in one.only_line()
    assert not folder.exists()


@pytest.mark.parametrize("index", [0, 1])
def test_a_process_whose_fellow_never_comes(index, tmp_path):
    wait = "from pecjax.runtime import distributed; distributed.JOIN_SECONDS = 3; distributed.join"
    waiting = One([sys.executable, "-c", f"{wait}('localhost:{free_port()}', 2, {index})"], tmp_path / "one")
    assert waiting.exit_code(60) != 0
    assert "not all processes came within 3 s" in waiting.only_line()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--process-id", "1"], "need --coordinator"),
        (["--coordinator", "localhost:1234"], "several processes need one folder"),
        (["--coordinator", "localhost", "--out", "x"], "coordinator is 'localhost'; give HOST:PORT"),
        (["--coordinator", "localhost:1", "--num-processes", "2", "--out", "x"], "process-id is None"),
        (
            ["--coordinator", "localhost:1", "--num-processes", "2", "--process-id", "2", "--out", "x"],
            "process-id is 2",
        ),
    ],
)
def test_wrong_words_for_several_processes(args, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["train", *args]) == 2
    assert words in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_auto_needs_a_cluster():
    with pytest.raises(pecjax.InputError, match=r"coordinator auto: .*could not be joined"):
        processes.join("auto")
