"""The one-way flow between the layers, and what importing the package does and offers."""

import ast
import importlib.util
import json
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pecjax

ROOT = Path(__file__).parents[1]

IMPORT = """
import json, os, sys, threading
before = dict(os.environ)
import pecjax
import jax
from jax._src import xla_bridge
report = {
    "environment": dict(os.environ) == before,
    "backend": xla_bridge.backends_are_initialized(),
    "training": sorted(name for name in sys.modules if name.startswith("pecjax.training")),
}
pecjax.curriculum.pec(num_configs=3)
report["simulators"] = sorted({"mujoco", "brax", "flax", "cattrs"} & set(sys.modules))
print(json.dumps(report))
"""


def test_layers_import_only_from_above():
    lint = subprocess.run(
        [Path(sys.executable).parent / "lint-imports", "--no-cache"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert lint.returncode == 0, lint.stdout + lint.stderr
    assert "4 kept, 0 broken" in lint.stdout


def test_agents_and_samplers_know_nothing_of_each_others_files():
    """Whatever is plugged in is plugged in by its contract."""
    agents = ROOT / "pecjax" / "agents"
    text = {str(path.relative_to(agents)): path.read_text() for path in agents.rglob("*.py")}
    assert {"base.py", "rollout.py", "ppo/agent.py", "ppo/update.py", "apex/agent.py"} <= set(text)
    for name, source in text.items():
        imports = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)]
        taken = {n.name for i in imports if str(i.module).startswith("pecjax.curriculum") for n in i.names}
        assert taken <= {"Sampler", "Outcomes", "by_config", "count_outcomes", "diagnose"}, name
        # Nor do the kinds of agents know one another.
        kind, _, file = name.partition("/")
        other = {"ppo": "agents.apex", "apex": "agents.ppo"}.get(kind) if file else None
        assert other is None or other not in source, name


IMPORT_BENCHMARKS = """
import importlib, pathlib, sys
sys.path.insert(0, "benchmarks")
for path in sorted(pathlib.Path("benchmarks").glob("*.py")):
    try:
        importlib.import_module(path.stem)
    except ModuleNotFoundError as error:
        if error.name.partition(".")[0] not in {"brax", "rejax", "stable_baselines3", "torch"}:
            raise
    else:
        print(path.stem)
"""


def test_benchmarks_use_what_is_there():
    """All that need nobody else's code can be begun."""
    found = subprocess.run(
        [sys.executable, "-c", IMPORT_BENCHMARKS], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert found.returncode == 0, found.stderr
    assert {"bounds", "failure_counts", "learning", "paired", "race", "throughput"} <= set(
        found.stdout.split()
    )


def test_scripts_name_what_is_there():
    """What benchmarks and scripts of the docs take from pecjax, within functions, too."""
    scripts = [path for folder in ("benchmarks", "docs") for path in sorted((ROOT / folder).glob("*.py"))]
    taken = [
        (path.name, part.module, name.name)
        for path in scripts
        for part in ast.walk(ast.parse(path.read_text()))
        if isinstance(part, ast.ImportFrom) and (part.module or "").startswith("pecjax")
        for name in part.names
    ]
    assert any(script == "race.py" and name == "on_devices" for script, _, name in taken)
    for script, module, name in taken:
        assert hasattr(importlib.import_module(module), name) or importlib.util.find_spec(
            f"{module}.{name}"
        ), f"{script}: {module}.{name}"


def test_files_are_short():
    lines = {path: path.read_text().count("\n") for path in (ROOT / "pecjax").rglob("*.py")}
    assert len(lines) > 100
    longest = max(lines, key=lambda path: lines[path])
    assert lines[longest] <= 250, longest
    assert statistics.median(lines.values()) <= 130


@pytest.fixture(scope="module")
def imported():
    """What a fresh process has to say after `import pecjax`."""
    return subprocess.run(
        [sys.executable, "-c", IMPORT], cwd=ROOT, capture_output=True, text=True, timeout=120
    )


def test_importing_prints_nothing(imported):
    assert imported.returncode == 0, imported.stderr
    assert imported.stdout.count("\n") == 1 and imported.stderr == ""


def test_importing_leaves_the_environment_and_the_devices_alone(imported):
    report = json.loads(imported.stdout)
    assert report["environment"]
    assert not report["backend"]
    # The command line's libraries (figures, tables, checkpoints) are for those who run it.
    assert report["training"] == []
    # Nor does a loop of one's own need a simulator for the samplers.
    assert report["simulators"] == []


@pytest.mark.parametrize(
    "name",
    [
        "load_scene",
        "depth_image",
        "RoomsNavigation",
        "COORDINATE_SET_1",
        "COORDINATE_SET_2",
        "Configurations",
        "Rooms",
        "Task",
        "TaskSettings",
        "RunSettings",
        "train",
        "open_run",
        "export_policy",
        "find_preset",
        "set_path",
        "Sink",
        "sinks.Callback",
        "sinks.TensorBoard",
        "sinks.WandB",
        "curriculum.pec",
        "curriculum.uniform",
        "curriculum.Outcomes",
        "curriculum.Sampler",
        "agents.PPO",
        "agents.PPO.make",
        "agents.Apex.make",
        "agents.AgentSettings",
    ],
)
def test_public_names(name):
    found = pecjax
    for part in name.split("."):
        found = getattr(found, part)
    assert found is not None


def test_every_name_that_is_listed_can_be_had():
    for name in dir(pecjax):
        assert getattr(pecjax, name) is not None or name.startswith("__"), name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        pecjax.nothing()


def test_what_the_public_objects_hold(scene):
    assert scene.model.nbody == 2 and scene.drone_radius == 0.25
    assert scene.wall_lower.shape == scene.wall_upper.shape == (14, 3)
    assert np.all(scene.wall_lower < scene.wall_upper)
    for table, size in ((pecjax.COORDINATE_SET_1, 20), (pecjax.COORDINATE_SET_2, 24)):
        assert table.start.shape == table.goal.shape == (size, 2)
    sampler = pecjax.curriculum.pec(num_configs=20, alpha=0.2)
    assert sampler._fields == ("init", "probabilities", "sample", "update")
    told = ("config_id", "done", "failed", "length", "episode_return", "signal")
    assert pecjax.curriculum.Outcomes._fields == told
    for kind in (pecjax.agents.PPO, pecjax.agents.Apex):
        agent = kind().make(pecjax.RoomsNavigation(scene).task, sampler)
        assert {"init", "iterate", "policy"} <= set(agent._fields)
    assert pecjax.InputError.__mro__[1] is ValueError


def test_the_version_is_the_distributions():
    text = (ROOT / "pyproject.toml").read_text()
    assert f'version = "{pecjax.__version__}"' in text
    assert f"\nversion: {pecjax.__version__}\n" in (ROOT / "CITATION.cff").read_text()
