"""Exported policies: other runtimes come to the same numbers, and fly the same flights."""

import dataclasses
import hashlib
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from test_depth import EDGE_FRACTION, poses

import pecjax
from pecjax.agents import PPO
from pecjax.agents.networks import NetworkSettings
from pecjax.cli import main
from pecjax.envs.rooms.controller import Command
from pecjax.envs.rooms.flight import DroneState, rotor_controls
from pecjax.envs.rooms.sensing import scale
from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, TaskSettings, Transition, World, take_configs
from pecjax.export.policy import ACTION, input_names, policy_of
from pecjax.training.build import abstract_state, build
from pecjax.training.checkpoint import Checkpoints
from pecjax.training.run_directory import RunDirectory

onnx, onnxruntime = (pytest.importorskip(name) for name in ("onnx", "onnxruntime"))
pytest.importorskip("flatbuffers")

ROOT = Path(__file__).parents[1]
EXAMPLES = ["exported_policy", "velocity_controller", "mujoco_rooms", "fly_exported", "ros_node"]
READ_BY_JAX = """
import sys
import jax, numpy as np
for folder in sys.argv[1:]:
    program = jax.export.deserialize(bytearray(open(f"{folder}/policy_jax.bin", "rb").read()))
    np.savez(f"{folder}/outputs.npz", **program.call(dict(np.load(f"{folder}/inputs.npz"))))
assert "pecjax" not in sys.modules
"""


# In a process where there is neither.
WITHOUT_JAX = """
import sys
sys.modules["jax"] = sys.modules["pecjax"] = None
import fly_exported
fly_exported.main(sys.argv[1], 3)
"""


@dataclasses.dataclass(frozen=True)
class Odd(TaskSettings):
    """Whatever a task may show: several images, with channels too, numbers without an axis, nested."""

    actions: int = 0  # 0 for continuous ones

    def make(self):
        return OddTask(self.actions), World((), np.zeros((2, 1), np.float32))


class OddTask(Task):
    max_steps = 3

    def __init__(self, actions):
        self.observation_space = {
            "z": Box((7, 9), 0.0, 2.0),
            "a": (Box((3,)), {"in": Box((9, 6, 2))}),
            "b": Box(()),
        }
        self.action_space = Discrete(actions) if actions else Box((3,), -0.5, 2.0)

    def reset(self, key, config, params):
        return config

    def step(self, key, state, action, params):
        no = jax.numpy.zeros((), bool)
        return Transition(state, jax.numpy.float32(0), no, no, no, {})

    def observe(self, key, state, params):
        return jax.tree.map(lambda box: jax.numpy.zeros(box.shape), self.observation_space)


RUNS = {
    "mlp": pecjax.find_preset("fast"),
    "cnn": pecjax.find_preset("image"),
    "apex": pecjax.find_preset("apex-fast"),
    "odd": pecjax.RunSettings(task=Odd(), agent=PPO(network=NetworkSettings("cnn", hidden=(8,)))),
    "lone": pecjax.RunSettings(
        task=Odd(actions=4), agent=PPO(network=NetworkSettings(hidden=(8, 8, 8), initializer="normc"))
    ),
    "gru": pecjax.RunSettings(agent=PPO(network=NetworkSettings(memory="gru", memory_size=12))),
    "mingru": pecjax.RunSettings(
        task=Odd(), agent=PPO(network=NetworkSettings("cnn", hidden=(8, 6), memory="mingru"))
    ),
    "stack": pecjax.RunSettings(
        agent=PPO(network=NetworkSettings(hidden=(8, 6), memory="stack", memory_size=5, memory_stride=2))
    ),
}


REMEMBER = ("gru", "mingru", "stack")


def make_run(folder, settings, gain=1):
    """A run whose policy is random; with a large gain it does not do the same all the time."""
    RunDirectory(folder).create(settings, 1)
    like, draw = abstract_state(build(settings, 1, trains=False)).learner, np.random.default_rng(0)

    def random(leaf):
        scale = gain * leaf.shape[0] ** -0.5 if leaf.ndim > 1 else 0.1
        return draw.normal(0, scale, leaf.shape).astype(leaf.dtype)

    Checkpoints(folder).save_learner(1, jax.tree.map(random, like))
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Runs by name, each exported to both formats."""
    folder = tmp_path_factory.mktemp("exported")
    made = {name: make_run(folder / name, RUNS[name], 4 if name == "mlp" else 1) for name in RUNS}
    for run in made.values():
        for format in ("onnx", "jax"):
            pecjax.export_policy(run, format)
    return made


@pytest.fixture(scope="module")
def by_jax(runs):
    """Inputs and outputs of each run, of a process that has the file and JAX alone."""
    inputs = {name: random_inputs(description(run), 1000) for name, run in runs.items()}
    for name, run in runs.items():
        np.savez(run / "inputs.npz", **inputs[name])
    subprocess.run([sys.executable, "-c", READ_BY_JAX, *runs.values()], check=True, timeout=120)
    return {name: (inputs[name], dict(np.load(run / "outputs.npz"))) for name, run in runs.items()}


def description(run, name="policy"):
    return json.loads((run / f"{name}.json").read_text())


def random_inputs(about, number):
    """Observations within their bounds; images in the middle of one of 255 steps, which Ape-X rounds to."""
    draw, inputs = np.random.default_rng(1), {}
    for tensor in about["inputs"]:
        shape = (number, *tensor["shape"][1:])
        if "high" in tensor:
            low, high = tensor["low"], tensor["high"]
            step = draw.integers(0, 256, shape) + draw.uniform(-0.4, 0.4, shape)
            inputs[tensor["name"]] = np.float32(low + (high - low) * np.clip(step, 0, 255) / 255)
        else:
            inputs[tensor["name"]] = np.float32(draw.normal(0, 1, shape))
    return inputs


def our_actions(run, inputs):
    """What `Trained.policy` does, observation by observation."""
    trained = pecjax.open_run(run)
    space = trained.run.task.observation_space
    obs = jax.tree.unflatten(jax.tree.structure(space), [inputs[name] for name in input_names(space)])
    act, key = trained.policy(greedy=True), jax.random.key(0)
    if "memory" in inputs:
        acts = jax.jit(jax.vmap(lambda one, memory: act(one, key, memory)))
        return [np.asarray(found) for found in acts(obs, inputs["memory"])]
    return [np.asarray(jax.jit(jax.vmap(lambda one: act(one, key)))(obs))]


@pytest.mark.parametrize("name", RUNS)
def test_onnxruntime_and_a_fresh_jax_agree_with_the_policy(name, runs, by_jax):
    """On 1,000 observations: both runtimes on the network's output, and both with our actions."""
    run, (inputs, outputs) = runs[name], by_jax[name]
    about = description(run)
    onnx.checker.check_model(onnx.load(run / "policy.onnx"), full_check=True)
    session = onnxruntime.InferenceSession(run / "policy.onnx")
    described = about["inputs"], about["outputs"]
    for tensors, there in zip(described, (session.get_inputs(), session.get_outputs()), strict=True):
        assert [(t["name"], t["shape"]) for t in tensors] == [(t.name, t.shape) for t in there]
        kinds = {"tensor(float)": "float32", "tensor(int32)": "int32"}
        assert [t["dtype"] for t in tensors] == [kinds[t.type] for t in there]
    values, actions, *after = session.run(None, inputs)
    size = np.abs(values).max()
    assert np.abs(outputs[session.get_outputs()[0].name] - values).max() <= 1e-5 * size
    ours, *our_memory = our_actions(run, inputs)
    assert len(after) == len(our_memory) == (name in REMEMBER)
    for found, wanted in zip(after, our_memory, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-5)
        np.testing.assert_allclose(outputs["memory_after"], wanted, atol=1e-5)
        assert np.abs(found).mean() > 0.1
    for found in (actions, outputs[ACTION]):
        assert found.dtype == about["outputs"][1]["dtype"] and found.shape == ours.shape
        if found.ndim == 1:
            # Where the best two are as good as equal, rounding may choose.
            best = np.sort(values)[:, ::-1]
            clear = best[:, 0] - best[:, 1] > 1e-5 * size
            assert clear.mean() > 0.99 and (found == ours)[clear].all()
            assert len(np.unique(found)) > 2, "agreeing would be easy"
        else:
            np.testing.assert_allclose(found, ours, atol=1e-5)
            assert found.std(axis=0).min() > 0.05


def test_the_description_is_of_the_file_and_names_its_run(runs):
    run = runs["mlp"]
    for format, name in (("onnx", "policy.onnx"), ("jax", "policy_jax.bin")):
        content, about = (run / name).read_bytes(), description(run, Path(name).stem)
        assert about["sha256"] == hashlib.sha256(content).hexdigest()
        assert (about["format"], about["file"]) == (format, name)
        assert about["run"]["label"] == "pec (α = 0.2), PPO, coordinates 1, seed 0"
        assert about["run"]["checkpoint"] == 1 and about["run"]["preset"] == "fast"
        kept = json.loads((run / "config.json").read_text())
        assert about["run"]["git_commit"] == kept["git_commit"]
        assert about["run"]["versions"] == kept["versions"]
        assert about["exported_with"]["jax"] == jax.__version__
        assert str(ROOT).encode() not in content, "the folder of whoever exported it"
    assert "camera" not in description(runs["odd"])


def test_an_export_is_repeated_and_replaced(runs, tmp_path, capsys):
    run, out = runs["mlp"], tmp_path / "new" / "other.onnx"
    for _ in range(2):
        assert main(["export", str(run), "--out", str(out), "--checkpoint", "1"]) == 0
    assert capsys.readouterr().out.split()[:2] == [str(out), str(out.with_suffix(".json"))]
    assert sorted(path.name for path in out.parent.iterdir()) == ["other.json", "other.onnx"]
    assert out.read_bytes() == (run / "policy.onnx").read_bytes()
    assert json.loads(out.with_suffix(".json").read_text()) == description(run) | {"file": "other.onnx"}


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["no_run"], "no_run: no run here"),
        (["RUN", "--format", "onx"], "unknown format 'onx' (did you mean onnx?); give onnx or jax"),
        (["RUN", "--checkpoint", "7"], "no checkpoint 7; there are 1"),
        (["RUN", "--out", "a/policy.json"], "ends in .json; give a file such as policy.onnx"),
        (["RUN", "--out", "."], "is a folder"),
        (["RUN", "--out", "file/policy.onnx"], "cannot be written (File exists); give another file"),
        (["RUN", "--fromat", "jax"], "unknown option --fromat (did you mean --format?)"),
    ],
)
def test_what_cannot_be_exported_is_told_in_one_line(words, line, runs, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    assert main(["export", *(str(runs["mlp"]) if word == "RUN" else word for word in words)]) == 2
    out, err = capsys.readouterr()
    assert line in err and err.count("\n") == 1 and out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(("format", "library"), [("onnx", "onnx"), ("jax", "flatbuffers")])
def test_a_missing_library_names_the_extra(format, library, runs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, library, None)
    missing = rf"the library {library} is missing; pip install 'pecjax\[export\]'"
    with pytest.raises(pecjax.InputError, match=missing):
        pecjax.export_policy(runs["mlp"], format, tmp_path / "policy")
    assert not [*tmp_path.iterdir()]


def test_networks_that_are_not_ours_and_names_that_clash(tmp_path):
    agent = dataclasses.make_dataclass("Mine", [], bases=(PPO,), frozen=True)
    agent.__module__ = __name__
    trained = pecjax.open_run(make_run(tmp_path / "run", RUNS["lone"]))
    mine = trained._replace(settings=dataclasses.replace(trained.settings, agent=agent()))
    with pytest.raises(pecjax.InputError, match="Mine cannot be exported; only policies of ppo and apex can"):
        policy_of(mine)
    trained.run.task.observation_space = {"action": Box((2,))}
    with pytest.raises(
        pecjax.InputError, match="observation 'action' has the name of another input or output"
    ):
        policy_of(trained)


@pytest.fixture(scope="module")
def examples():
    """The examples by name; their folder is on the path as it is where one of them is started."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "examples"))
        yield {name: importlib.import_module(name) for name in EXAMPLES}


@pytest.fixture(scope="module")
def other_run(other_map, tmp_path_factory):
    """A run in the other map, whose camera looks down and whose walls are of every kind."""
    table = tmp_path_factory.mktemp("other") / "table.csv"
    table.write_text("-2,0,3,-2\n")
    run = make_run(
        table.parent / "run", pecjax.RunSettings(task=pecjax.Rooms(table=str(table), maps=(str(other_map),)))
    )
    pecjax.export_policy(run)
    return run


@pytest.mark.parametrize("which", ["rooms", "other"])
def test_the_examples_camera_sees_what_ours_sees(which, runs, other_run, examples):
    run = runs["mlp"] if which == "rooms" else other_run
    scene = pecjax.open_run(run).settings.task.scenes()[0]
    simulation = examples["mujoco_rooms"].Simulation(run / "scene.xml", description(run))
    places, quaternions = poses(scene, seed=3)
    cast = jax.jit(jax.vmap(lambda place, quaternion: pecjax.depth_image(scene, place, quaternion)))
    ours, theirs = np.asarray(cast(np.float32(places), np.float32(quaternions))), []
    for place, quaternion in zip(places, quaternions, strict=True):
        simulation.place(place, 0.0)
        simulation.data.qpos[3:] = quaternion
        mujoco.mj_fwdPosition(simulation.model, simulation.data)
        theirs.append(simulation.depth())
    camera = scene.vehicle.camera
    off = np.abs(ours - np.clip(theirs, camera.near, camera.far)) > 1e-3
    assert off.mean() <= EDGE_FRACTION and np.isinf(theirs).any()


def test_the_examples_controller_is_ours(runs, scene, examples):
    """At any state and command, at the rotors' limits too, with the turn's feed-forward and without."""
    about, draw, number = description(runs["mlp"]), np.random.default_rng(0), 300
    quaternions = draw.normal([1, 0, 0, 0], 0.3, (number, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    states = np.concatenate(
        [draw.normal(1, 1, (number, 3)), quaternions, draw.normal(0, 1, (number, 6))], axis=1
    )
    commands = draw.uniform([0, -2], [2, 2], (number, 2))
    for feed_forward in (True, False):
        gains = pecjax.ControllerGains(turn_feed_forward=feed_forward)

        def controls(state, command, gains=gains):
            asked = Command(command[0], command[1], about["control"]["flight_height_m"])
            return rotor_controls(scene.vehicle, gains, DroneState(state[:7], state[7:]), asked)

        ours = jax.jit(jax.vmap(controls))(np.float32(states), np.float32(commands))
        about["controller"]["turn_feed_forward"] = feed_forward
        controller, theirs = examples["velocity_controller"].VelocityController(about), []
        for state, command in zip(states, commands, strict=True):
            rotation = np.empty(9)
            mujoco.mju_quat2Mat(rotation, state[3:7])
            sensed = rotation.reshape(3, 3), state[2], state[7:10], state[10:]
            theirs.append(controller.controls(*sensed, *command))
        np.testing.assert_allclose(theirs, ours, atol=2e-4)
        lower, upper = about["drone"]["rotor_lower"], about["drone"]["rotor_upper"]
        assert (np.isclose(theirs, lower) | np.isclose(theirs, upper)).any(axis=0).all()


def test_a_flight_of_the_example_is_ours_action_by_action(runs, env, step, examples):
    """The same policy in both: observations, actions, and where they lead to."""
    seen_from, run = examples["exported_policy"], runs["mlp"]
    policy = seen_from.ExportedPolicy(run / "policy.onnx")
    simulation = examples["mujoco_rooms"].Simulation(run / "scene.xml", policy.about)
    greedy, key = pecjax.open_run(run).policy(greedy=True), jax.random.key(0)
    act = jax.jit(lambda obs: greedy(obs, key))
    config, commands = take_configs(env.configurations, 6), []
    state = jax.jit(env.reset_to)(config, jax.random.key(1))
    where = simulation.data.qpos
    simulation.place(state.pipeline_state.qpos[:3], seen_from.heading(state.pipeline_state.qpos[3:]))
    for _ in range(25):
        ours = scale(state.obs, env.scene.vehicle.camera.far)
        seen = simulation.depth(), *seen_from.towards(config.goal, where, seen_from.heading(where[3:]))
        theirs = policy.inputs(*seen)
        np.testing.assert_allclose(theirs["goal"][0], ours["goal"], atol=1e-3)
        assert (np.abs(theirs["depth"][0] - ours["depth"]) > 1e-3).mean() < 0.02
        action = act(ours)
        commands.append(policy.act(*seen))
        assert commands[-1] == tuple(policy.about["actions"][int(action)].values())
        state = step(state, action)
        assert simulation.step(*commands[-1]) == bool(state.metrics["collision"])
        np.testing.assert_allclose(where[:3], state.pipeline_state.qpos[:3], atol=1e-3)
    assert len(set(commands)) > 2, "agreeing would be easy"


def test_a_collision_is_told(runs, examples):
    simulation = examples["mujoco_rooms"].Simulation(runs["mlp"] / "scene.xml", description(runs["mlp"]))
    simulation.place([6.5, -2, 1.2], 0.0)
    wall, radius, x = 7.9, 0.25, [6.5]
    while not simulation.step(2.0, 0.0):
        x.append(simulation.data.qpos[0])
    assert x[-1] < wall - radius <= simulation.data.qpos[0] + 0.01 and len(x) > 5


def test_examples_run_without_jax_and_pecjax(runs, examples):
    run = runs["mlp"]
    command = [sys.executable, "-c", WITHOUT_JAX, run]
    done = subprocess.run(
        command, cwd=ROOT / "examples", capture_output=True, text=True, timeout=120, check=True
    )
    assert re.fullmatch(r"reached the goal in \d of 3 episodes, 95 % \[0\.\d+, [01]\.\d+\]\n", done.stdout)
    assert examples["mujoco_rooms"].main(run).shape == (12, 16)
    speed, height = examples["velocity_controller"].main(run)
    assert speed == pytest.approx(1, abs=0.02) and height == pytest.approx(1.2, abs=0.01)
    examples["exported_policy"].main(run / "policy.onnx")


def test_a_file_of_another_export_is_refused(runs, examples, tmp_path):
    (tmp_path / "policy.onnx").write_bytes((runs["cnn"] / "policy.onnx").read_bytes())
    (tmp_path / "policy.json").write_text((runs["mlp"] / "policy.json").read_text())
    with pytest.raises(ValueError, match="not the file that its JSON describes"):
        examples["exported_policy"].ExportedPolicy(tmp_path / "policy.onnx")


@pytest.fixture
def node(runs, examples):
    return examples["ros_node"].PolicyNode(runs["mlp"] / "policy.onnx")


def at(seconds):
    return {"header": {"stamp": {"sec": int(seconds), "nanosec": round(seconds % 1 * 1e9)}}}


def image_message(pixels, encoding, big, spare=0):
    """An image whose rows end in some bytes that are no pixels."""
    dtype = np.dtype({"32FC1": "f4", "16UC1": "u2"}[encoding]).newbyteorder(">" if big else "<")
    data = np.ascontiguousarray(pixels, dtype).view(np.uint8)
    rows = np.pad(data, [(0, 0), (0, spare)], constant_values=255)
    size = {"height": pixels.shape[0], "width": pixels.shape[1], "step": rows.shape[1]}
    return at(1.0) | size | {"encoding": encoding, "is_bigendian": int(big), "data": rows.tobytes()}


def odometry(position, yaw, seconds=1.0):
    turned = {"x": 0.0, "y": 0.0, "z": np.sin(yaw / 2), "w": np.cos(yaw / 2)}
    return at(seconds) | {
        "pose": {"pose": {"position": dict(zip("xyz", position, strict=True)), "orientation": turned}}
    }


def goal_message(x, y):
    return at(0.0) | {"pose": {"position": {"x": x, "y": y, "z": 0.0}}}


@pytest.mark.parametrize(("encoding", "big"), [("32FC1", False), ("32FC1", True), ("16UC1", True)])
def test_the_node_reads_the_pixels_in_the_middle_of_the_networks(encoding, big, node):
    """Of an image 40 times as fine each way, all of which is known."""
    row, column = np.mgrid[:480, :640]
    metres = 1 + row / 1000 + column / 100
    node.on_depth(image_message(metres * (1000 if encoding == "16UC1" else 1), encoding, big, spare=8))
    rows, columns = np.mgrid[:12, :16] * 40 + 20
    np.testing.assert_allclose(node.latest["depth"][1], 1 + rows / 1000 + columns / 100, atol=1e-3)
    low = np.arange(192.0).reshape(12, 16) + 1
    low[0, :3] = (np.nan, 0, np.inf) if encoding == "32FC1" else 0
    node.on_depth(image_message(low, encoding, big))
    expected = low.copy() * (0.001 if encoding == "16UC1" else 1)
    expected[0, :3] = np.inf
    np.testing.assert_allclose(node.latest["depth"][1], expected)


def test_the_node_commands_what_the_policy_does(node):
    draw, commands = np.random.default_rng(0), set()
    for _ in range(20):
        depth, yaw, place = draw.uniform(0.2, 12, (12, 16)), draw.uniform(-3, 3), draw.uniform(-2, 2, 3)
        node.on_depth(image_message(depth, "32FC1", False))
        node.on_odometry(odometry(place, yaw))
        node.on_goal(goal_message(5.0, -1.0))
        twist = node.on_timer(now=1.1)
        offset = complex(5 - place[0], -1 - place[1])
        speed, yaw_rate = node.policy.act(depth, abs(offset), np.angle(offset / np.exp(1j * yaw)))
        assert twist["linear"] == {"x": speed, "y": 0.0, "z": pytest.approx(1.5 * (1.2 - place[2]))}
        assert twist["angular"] == {"x": 0.0, "y": 0.0, "z": yaw_rate}
        commands.add((speed, yaw_rate))
    assert len(commands) > 2


def test_the_node_stands_still_where_it_knows_too_little(node, examples, runs):
    still = {"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
    assert node.on_timer(now=0.0) == still, "nothing has come"
    shown = ((depth, examples["ros_node"].main(runs["mlp"] / "policy.onnx", depth)) for depth in range(1, 10))
    moves = next(d for d, twist in shown if twist["linear"]["x"] or twist["angular"]["z"])
    node.on_depth(image_message(np.full((12, 16), moves), "32FC1", False))
    node.on_odometry(odometry((0, 0, 1.2), 0.0))
    assert node.on_timer(now=1.0) == still, "no goal"
    node.on_goal(goal_message(3.0, 0.0))
    assert node.on_timer(now=1.2) != still
    assert node.on_timer(now=1.4) == still, "silent for more than three periods"
    node.on_odometry(odometry((0, 0, 1.0), 0.0, seconds=1.4))
    assert node.on_timer(now=1.4) == still | {"linear": {"x": 0.0, "y": 0.0, "z": pytest.approx(0.3)}}
    node.on_odometry(odometry((2.6, 0, 1.2), 0.0))
    assert node.on_timer(now=1.0) == still, "it is there"


@pytest.mark.slow
def test_it_reaches_goals_as_often_as_in_mjx(tmp_path, examples):
    """Of a policy that reaches some: the difference of two ratios, 99.9 %."""
    settings = pecjax.find_preset("fast")
    for path, value in (("stop.iterations", 24), ("evaluation.episodes", 200), ("task.max_steps", 200)):
        settings = pecjax.set_path(settings, path, value)
    ours = pecjax.train(settings, out=tmp_path / "run").evaluation[-1]["goal_ratio"]
    pecjax.export_policy(tmp_path / "run")
    theirs = examples["fly_exported"].main(tmp_path / "run", 200) / 200
    both = (ours + theirs) / 2
    assert 0.1 < both < 0.95, "agreeing would be easy"
    assert abs(ours - theirs) < 3.29 * np.sqrt(2 * both * (1 - both) / 200)


def test_the_page_explains_every_part_and_its_commands_run(runs, examples, monkeypatch, capsys):
    page = (ROOT / "docs" / "export.md").read_text()
    for key, value in description(runs["mlp"]).items():
        assert f"`{key}`" in page, key
        for inner in value if isinstance(value, dict) and key != "exported_with" else ():
            assert f"`{inner}`" in page, f"{key}.{inner}"
    monkeypatch.chdir(runs["mlp"].parent)
    Path("runs").mkdir()
    Path("runs/a").symlink_to(runs["mlp"])
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(block, {})
    commands = re.findall(r"^pecjax (export .*?)(?: #.*)?$", page, re.MULTILINE)
    assert len(commands) >= 2
    for command in commands:
        # The run here is short; that of the page is evaluated every 50 iterations, as by default.
        assert main(command.replace("--checkpoint 50", "--checkpoint 1").split()) == 0
    for name in re.findall(r"examples/(\w+)\.py", page):
        assert name in EXAMPLES
