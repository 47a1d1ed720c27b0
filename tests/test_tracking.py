"""Tracking: what TensorBoard and W&B hold is what the run's tables hold, also after a resume."""

import json
import re
import struct
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from probe_tasks import TARGET_WORLD, Target

import pecjax
from pecjax import settings_tree
from pecjax.agents import PPO
from pecjax.agents.networks import NetworkSettings
from pecjax.cli import main
from pecjax.errors import DivergedError
from pecjax.training import train as training
from pecjax.training.kinds import run_label
from pecjax.training.sinks import Sinks


@dataclass(frozen=True)
class TargetSettings(pecjax.TaskSettings):
    """The smallest of the probe tasks."""

    def make(self):
        return Target(), TARGET_WORLD


AGENT = PPO(num_envs=8, num_steps=4, num_epochs=1, num_minibatches=2, network=NetworkSettings(hidden=(4,)))


def settings(iterations):
    base = pecjax.RunSettings(task=TargetSettings(), agent=AGENT)
    base = replace(base, evaluation=replace(base.evaluation, every=2, episodes=6))
    return replace(base, stop=replace(base.stop, iterations=iterations))


def train_and_resume(folder, make_sink):
    """Three iterations; then, from the second as after a kill, on to the fifth.

    The tracker has heard of a third iteration and of its evaluation, which the tables then lack: only as
    the last was it evaluated.
    """
    training.train(settings(3), folder, 1, [make_sink()])
    for kept in ("states", "checkpoints"):
        (folder / kept / "3.npz").unlink()
    training.resume(settings(5), folder, 1, [make_sink()])
    evaluated = pd.read_csv(folder / "evaluation.csv").iteration
    assert evaluated.tolist() == [2, 4, 5]


def tables(folder):
    """What a tracker should hold: [(env_steps, value), …] by name."""
    found = {}
    for table in ("metrics", "evaluation"):
        rows = pd.read_csv(folder / f"{table}.csv").drop(columns="seconds", errors="ignore")
        for name in rows.columns.drop(["iteration", "env_steps"]):
            kept = rows[["env_steps", name]].dropna().to_numpy()
            if kept.size:
                found[f"{table}/{name}"] = kept
        if table == "metrics":
            found["iteration"] = rows[["env_steps", "iteration"]].to_numpy()
    return found


def assert_holds_the_tables(found, folder):
    expected = tables(folder)
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-6, err_msg=name)


@pytest.fixture(scope="module")
def tracked(tmp_path_factory):
    """A run that was resumed, with TensorBoard."""
    pytest.importorskip("tensorboardX")
    folder = tmp_path_factory.mktemp("tracked") / "run"
    train_and_resume(folder, pecjax.sinks.TensorBoard)
    return folder


def test_tensorboard_holds_the_tables_after_a_resume(tracked):
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = reader.EventAccumulator(str(tracked / "tensorboard"), {reader.SCALARS: 0}).Reload()
    names = events.Tags()["scalars"]
    found = {name: [(event.step, event.value) for event in events.Scalars(name)] for name in names}
    assert_holds_the_tables(found, tracked)


def test_tensorboard_has_the_settings_and_the_name(tracked):
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    plugin_data = pytest.importorskip("tensorboard.plugins.hparams.plugin_data_pb2")
    events = reader.EventAccumulator(str(tracked / "tensorboard")).Reload()
    texts = {event.tensor_proto.string_val[0].decode() for event in events.Tensors("run/text_summary")}
    assert texts == {run_label(settings(5))}
    data = plugin_data.HParamsPluginData()
    data.ParseFromString(events.summary_metadata["_hparams_/session_start_info"].plugin_data.content)
    told = data.session_start_info.hparams
    assert told["agent.learning_rate"].number_value == AGENT.learning_rate
    assert told.keys() == {path for path, _ in settings_tree.leaves(settings(5))}


def records(path):
    """The records of an offline run of W&B: blocks of 32 KiB as of LevelDB's log, after a head of 7 bytes."""
    messages = pytest.importorskip("wandb.proto.wandb_internal_pb2")
    data, place, whole = path.read_bytes(), 7, b""
    assert data.startswith(b":W&B")
    while place + 7 <= len(data):
        if 32768 - place % 32768 < 7:  # no room for another head in this block
            place += 32768 - place % 32768
            continue
        _, length, kind = struct.unpack_from("<IHB", data, place)
        whole += data[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in (1, 4):  # the whole of a record, or the last of its parts
            record = messages.Record()
            record.ParseFromString(whole)
            whole = b""
            yield record


def by_key(items):
    return {item.key or "/".join(item.nested_key): json.loads(item.value_json) for item in items}


def test_wandb_holds_the_tables_after_a_resume(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    folder = tmp_path / "run"
    train_and_resume(folder, lambda: pecjax.sinks.WandB("rooms", tags=["tested"]))
    sessions = [[*records(path)] for path in sorted(folder.glob("wandb/offline-run-*/*.wandb"))]
    assert len(sessions) == 2
    for session in sessions:
        (run,) = (record.run for record in session if record.WhichOneof("record_type") == "run")
        assert run.run_id == (folder / "wandb" / "run_id").read_text()
        assert (run.project, run.display_name, list(run.tags)) == (
            "rooms",
            run_label(settings(5)),
            ["tested"],
        )
    config = by_key(run.config.update)
    assert config["agent"]["learning_rate"] == AGENT.learning_rate
    assert {"task", "sampler", "agent", "evaluation", "stop", "seed"} <= config.keys()

    found = {}
    rows = [by_key(record.history.item) for record in sessions[1] if record.HasField("history")]
    assert [row["_step"] for row in rows] == [1, 2, 3, 4, 5]  # the first session's are written again
    for row in rows:
        for name, value in row.items():
            if name != "env_steps" and not name.startswith("_"):
                found.setdefault(name, []).append((row["env_steps"], value))
    assert_holds_the_tables(found, folder)


@pytest.fixture
def online(monkeypatch):
    """What W&B is told of a run of which it has the first three steps; then how it ended."""
    wandb = pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")  # so that nobody is asked to log in
    told, codes = [], []
    run = SimpleNamespace(
        step=4,
        log=lambda row, step: told.append((step, row)),
        define_metric=lambda *_, **__: None,
        finish=lambda exit_code: codes.append(exit_code),
    )
    monkeypatch.setattr(wandb, "init", lambda **_: run)
    return told, codes


def test_wandb_is_not_sent_what_it_has(tracked, online):
    sink = pecjax.sinks.WandB()
    sink.open([str(tracked)], 2)
    sink.rows("metrics", [{"iteration": 3, "env_steps": 96, "goal_ratio": 0.5}])
    sink.rows("metrics", [{"iteration": 6, "env_steps": 192, "goal_ratio": float("nan"), "kl": 0.1}])
    told, _ = online
    assert [step for step, _ in told] == [4, 4, 5, 5, 6]
    assert "metrics/goal_ratio" in told[0][1] and "evaluation/goal_ratio" in told[1][1]
    assert told[-1][1] == {"iteration": 6, "env_steps": 192, "metrics/kl": 0.1}


def test_a_training_that_fails_has_failed_on_wandb(tracked, online):
    with pytest.raises(DivergedError), Sinks([pecjax.sinks.WandB()], [str(tracked)], 0):
        raise DivergedError("as if it had")
    with Sinks([pecjax.sinks.WandB()], [str(tracked)], 0):
        pass
    assert online[1] == [1, 0]


def test_a_callback_hears_of_every_row():
    heard = []
    sink = pecjax.sinks.Callback(lambda table, rows: heard.append((table, *rows)))
    result = pecjax.train(settings(3), devices=1, sinks=[sink])
    assert [row for table, row in heard if table == "metrics"] == result.metrics
    assert [row for table, row in heard if table == "evaluation"] == result.evaluation
    assert [table for table, _ in heard] == ["metrics", "metrics", "evaluation", "metrics", "evaluation"]


@pytest.mark.parametrize(
    ("sink", "library", "extra"),
    [("TensorBoard", "tensorboardX", "tensorboard"), ("WandB", "wandb", "wandb")],
)
@pytest.mark.parametrize("a_folder_of_its_name", [False, True])
def test_a_missing_library_is_said_before_anything_is_written(
    tmp_path, monkeypatch, sink, library, extra, a_folder_of_its_name
):
    (tmp_path / library).mkdir() if a_folder_of_its_name else None
    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    with pytest.raises(pecjax.InputError, match=rf"{library} is missing; pip install 'pecjax\[{extra}\]'"):
        training.train(settings(1), tmp_path / "run", 1, [getattr(pecjax.sinks, sink)()])
    assert not (tmp_path / "run").exists()


def test_wandb_without_a_login_is_said_before_anything_is_written(tmp_path, monkeypatch):
    wandb = pytest.importorskip("wandb")

    def login():
        raise wandb.errors.UsageError("No API key configured.")

    monkeypatch.setattr(wandb, "login", login)
    monkeypatch.setenv("WANDB_MODE", "online")
    with pytest.raises(pecjax.InputError, match=r"^wandb: No API key configured.*WANDB_MODE=offline"):
        training.train(settings(1), tmp_path / "run", 1, [pecjax.sinks.WandB()])
    assert not (tmp_path / "run").exists()


def test_only_the_first_process_writes(tmp_path, monkeypatch):
    """Of all that a sink does nothing is done, and no library asked for."""
    monkeypatch.setattr("pecjax.runtime.distributed.is_primary", lambda: False)
    monkeypatch.setattr(sys, "path", [])
    row = {"iteration": 1, "env_steps": 32, "goal_ratio": 0.5}
    called = []
    sinks = pecjax.sinks
    for sink in (sinks.TensorBoard(), sinks.WandB(), sinks.Callback(lambda *rows: called.append(rows))):
        sink.check()
        sink.open([str(tmp_path)], 0)
        sink.rows("metrics", [row])
        sink.close()
    assert not called and not list(tmp_path.iterdir())


def test_the_command_line_tracks(tmp_path, monkeypatch):
    heard = {}

    def train(settings, folder, devices, sinks):
        heard["sinks"] = sinks
        raise pecjax.InputError("enough")

    monkeypatch.setattr(training, "train", train)
    assert main(["train", "--tensorboard", "--wandb", "rooms", "--out", str(tmp_path / "run")]) == 2
    assert [type(sink).__name__ for sink in heard["sinks"]] == ["TensorBoard", "WandB"]
    assert main(["train", "--out", str(tmp_path / "run")]) == 2 and heard["sinks"] == []


@pytest.mark.slow
def test_the_pages_python_runs_as_it_stands(gliding, tmp_path, monkeypatch):
    pytest.importorskip("tensorboardX")
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[1] / "docs" / "tracking.md"
    names = {}
    for block in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
        exec(block, names)
    assert len(names["goal_ratios"]) == 1 and list(tmp_path.glob("logs/first/events.out.tfevents.*"))
