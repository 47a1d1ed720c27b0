"""Thousands of broken files, each of which must be read or refused in one line, and soon.

    python tests/fuzz.py [--inputs 10000] [--seed 0]

Scenes and coordinate files go through what `pecjax check` does with them, run folders of this version and
of 0.1 through what `figures` and `eval` read first, checkpoints through what `eval` and `train --resume` do.
`test_untrusted_files.py` runs some hundreds of the same.
"""

from __future__ import annotations

import argparse
import random
import re
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

import pecjax
from pecjax.envs.rooms import load_coordinates, load_scene
from pecjax.envs.rooms.scene import default_scene_path
from pecjax.envs.rooms.validity import check_coordinates
from pecjax.plotting.run import _COLUMNS
from pecjax.storage.arrays import write_arrays
from pecjax.storage.tables import csv_text, read_table
from pecjax.studies.directory import StudyDirectory
from pecjax.training.checkpoint import Checkpoints
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_tables import configuration_table, trajectory_table

SECONDS = 20  # of processor time that one input may take, whatever else the machine does
PATIENCE = 300  # seconds by the clock after which it counts as hung
LEARNER = {"params": {"w": np.ones((7, 5), np.float32), "b": np.zeros(5, np.float32)}, "updates": np.array(3)}
SETTINGS_0_1 = {
    "preset": "fast", "algorithm": "apex", "ppo": {"num_envs": 8, "clip": 0.2, "network": {"hidden": [8, 9]}},
    "apex": {"num_envs": 8, "fragment": 2, "huber": 1.0, "replay": {"capacity": 64}}, "resolution": [20, 10],
    "sampler": "pec", "alpha": 0.2, "coordinates": "1", "scene": "my.xml", "seed": 0, "iterations": 9,
    "until_goal_ratio": 0.9, "patience": 5, "evaluate_every": 5, "evaluation_episodes": 20,
    "evaluation_seed": 2022, "greedy": True, "configurations_every": 10,
}  # fmt: skip
_TIMERS = {signal.ITIMER_PROF: (signal.SIGPROF, SECONDS), signal.ITIMER_REAL: (signal.SIGALRM, PATIENCE)}
NUMBERS = ["nan", "inf", "-1", "0", "1e308", "1e-300", "9" * 40, "", "x", "1 2 3 4 5 6 7 8 9", "-0.0", "1e9"]
PIECES = [
    '<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>',
    '<include file="../../etc/passwd"/>',
    '<include file="/etc/passwd"/>',
    '<include file="map.xml"/>',
    '<compiler meshdir="/"/>',
    '<size memory="900G"/>',
    '<size nuserdata="2000000000"/>',
    '<asset><texture name="t" builtin="checker" width="90000" height="90000"/></asset>',
    '<asset><hfield name="h" nrow="90000" ncol="90000" size="1 1 1 1"/></asset>',
    '<asset><mesh name="m" file="../secret.obj"/></asset>',
    '<worldbody><replicate count="100000000" offset="1 0 0"><geom size="1"/></replicate></worldbody>',
    '<worldbody><replicate count="400"><replicate count="400"><body/></replicate></replicate></worldbody>',
    '<worldbody><attach body="drone" prefix="x"/></worldbody>',
    '<asset><model name="m" file="map.xml"/><mesh name="m" builtin="plate" params="2000 2000"/></asset>',
    '<worldbody><geom type="plane" size="0 0 1"/><geom type="mesh" mesh="m" contype="0"/></worldbody>',
    '<asset><mesh name="m" file="m.obj"/><texture name="t" type="2d" file="t.png"/></asset>',
    '<option timestep="1e-12"/>',
    '<option gravity="nan nan nan"/>',
    "\x00",
    "\ufeff",
    "&amp;" * 50,
    "<a>" * 3000,
]


def mutate(text: str, rng: random.Random) -> bytes:
    """One to four changes: numbers, words, whole tags, bytes."""
    for _ in range(rng.randint(1, 4)):
        kind = rng.randrange(8)
        spans = [m.span() for m in re.finditer(r"-?\d+\.?\d*" if kind < 2 else r'"[^"]*"|<[^>]*>', text)]
        if kind < 2 and spans:
            low, high = rng.choice(spans)
            text = text[:low] + rng.choice(NUMBERS) + text[high:]
        elif kind < 5 and spans:
            low, high = rng.choice(spans)
            other = text[slice(*rng.choice(spans))]
            text = (
                text[:low] + rng.choice(["", other, other * 2, '"' + rng.choice(NUMBERS) + '"']) + text[high:]
            )
        elif kind == 5:
            place = rng.choice([m.end() for m in re.finditer(">", text)] or [0])
            text = text[:place] + rng.choice(PIECES) + text[place:]
        elif kind == 6:
            text = text[: rng.randrange(len(text) + 1)]
        else:
            place = rng.randrange(len(text) + 1)
            text = text[:place] + chr(rng.randrange(1, 0x2FF)) + text[place + rng.randrange(3) :]
    content = text.encode("utf-8", "surrogatepass")
    if rng.random() < 0.1 and content:
        place = rng.randrange(len(content))
        content = content[:place] + bytes([rng.randrange(256)]) + content[place + 1 :]
    return content


def scene_input(folder: Path, rng: random.Random) -> None:
    path = folder / "map.xml"
    path.write_bytes(mutate(default_scene_path().read_text(), rng))
    scene = load_scene(path)
    pecjax.RoomsNavigation(scene)


def coordinates_input(folder: Path, rng: random.Random, scene: pecjax.envs.rooms.Scene) -> None:
    path = folder / "pairs.csv"
    path.write_bytes(
        mutate("goal_x, goal_y, start_x, start_y\n5, -2, 0, -2\n-1 0 -1 4\n\n# a comment\n3, 2, 3, 6\n", rng)
    )
    check_coordinates(scene, load_coordinates(path), flight_height=1.2)


def run_input(folder: Path, rng: random.Random, run: Path) -> None:
    copy = folder / "run"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(run / "of 0.1" if rng.random() < 0.3 else run, copy)
    texts = sorted(path for path in copy.iterdir() if path.suffix in (".json", ".csv"))
    kept = sorted(path for name in ("configurations", "episodes") for path in (copy / name).glob("*.npz"))
    spoilt = rng.choice([*texts, *kept])
    if spoilt.suffix == ".npz":
        spoilt.write_bytes(mutate_bytes(spoilt.read_bytes(), rng))
    else:
        spoilt.write_bytes(mutate(spoilt.read_text(), rng))
    directory = RunDirectory(copy)
    directory.settings(), directory.num_devices(), directory.check_version()
    directory.task().configurations(), StudyDirectory(copy).settings()
    for name, columns in _COLUMNS.items():
        read_table(copy / f"{name}.csv", columns)
    configuration_table(directory), trajectory_table(directory)


def mutate_bytes(content: bytes, rng: random.Random) -> bytes:
    """Up to four changes: bytes, numbers of a header, pieces cut out or doubled."""
    changed = bytearray(content)
    for _ in range(rng.randint(0, 4)):
        first = rng.randrange(len(changed) + 1)
        last = min(len(changed), first + rng.choice([1, 2, 4, 8, 100]))
        kind = rng.randrange(6)
        if kind < 2:
            changed[first:last] = rng.randbytes(last - first)
        elif kind == 2:
            changed[first:last] = rng.choice([b"\0", b"\xff"]) * (last - first)
        elif kind == 3:
            del changed[first : last if rng.random() < 0.8 else None]
        elif kind == 4:
            changed[first:first] = changed[first:last]
        else:  # shapes and types stand in headers as text
            texts = [(m.start(), m.end()) for m in re.finditer(rb"\d+|'[^']*'|<f4|\(", bytes(changed))]
            low, high = rng.choice(texts or [(0, 0)])
            changed[low:high] = rng.choice(
                [b"9" * 12, b"|O", b"-1", b"True", b"(" * 99, b"0", b"__import__('os')"]
            )
    return bytes(changed)


def checkpoint_input(folder: Path, rng: random.Random, run: Path) -> None:
    copy = folder / "run"
    shutil.rmtree(copy, ignore_errors=True)
    (copy / "checkpoints").mkdir(parents=True)
    content = (run / "checkpoints" / "3.npz").read_bytes()
    (copy / "checkpoints" / "3.npz").write_bytes(mutate_bytes(content, rng))
    Checkpoints(copy).load_learner(LEARNER)


class TooSlowError(Exception):
    """An input took longer than it may."""


def attempt(one: Callable[[], None]) -> str:
    """What became of one input; everything but these three is raised."""

    def too_slow(*_: object) -> None:
        raise TooSlowError

    for timer, (number, most) in _TIMERS.items():
        signal.signal(number, too_slow)
        signal.setitimer(timer, most)
    try:
        one()
    except pecjax.InputError as error:
        message = str(error)
        assert message and "\n" not in message and len(message) < 1500, message
        return "refused"
    finally:
        for timer in _TIMERS:
            signal.setitimer(timer, 0)
    return "read"


def fuzz(inputs: int, seed: int, run: Path) -> Counter:
    """Tries so many inputs of each kind in turn; returns what became of them, by kind."""
    rng = random.Random(seed)
    scene = load_scene()
    found: Counter = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "inner"
        folder.mkdir()
        kinds = {
            "scene": lambda: scene_input(folder, rng),
            "coordinates": lambda: coordinates_input(folder, rng, scene),
            "run": lambda: run_input(folder, rng, run),
            "checkpoint": lambda: checkpoint_input(folder, rng, run),
        }
        for number in range(inputs):
            kind = list(kinds)[number % len(kinds)]
            state = rng.getstate()
            try:
                found[kind, attempt(kinds[kind])] += 1
            except BaseException:
                shutil.copytree(folder, f"fuzz-failure-{seed}-{number}", dirs_exist_ok=True)
                print(f"input {number} ({kind}), kept in fuzz-failure-{seed}-{number}; state {hash(state)}")
                raise
    return found


def sample_run(folder: Path) -> Path:
    """The files of a small run and a small study, as they would be written, and those of 0.1 below them."""
    from pecjax import settings_tree
    from pecjax.envs.configuration_files import table_text
    from pecjax.storage import files as plain_files
    from pecjax.studies.catalogue import find_study
    from pecjax.training.presets import PRESETS

    former = folder / "of 0.1"
    former.mkdir(parents=True, exist_ok=True)
    for name, content in (("config", PRESETS["fast"]), ("study", find_study("fig4"))):
        text = plain_files.json_text({"settings": settings_tree.to_json(content)})
        (folder / f"{name}.json").write_text(text)
    (former / "config.json").write_text(plain_files.json_text({"settings": SETTINGS_0_1}))
    study = {"name": "s", "run": SETTINGS_0_1, "samplers": ["pec", "uniform"], "grid": [["ppo.clip", [0.1]]]}
    (former / "study.json").write_text(plain_files.json_text({"settings": study}))
    Checkpoints(folder).save_learner(3, LEARNER)
    table = table_text(pecjax.COORDINATE_SET_1)
    both = (folder, former)
    for one in both:
        (one / "coordinates.csv").write_text(table)
        for name, columns in _COLUMNS.items():
            rows = [dict.fromkeys(sorted(columns), number * 0.5) for number in range(4)]
            (one / f"{name}.csv").write_text(csv_text(rows))
    counts = {name: np.arange(20) for name in ("trials", "failures", "probability")}
    flights = {
        "config_id": np.arange(3), "success": np.ones(3, bool), "return": np.zeros(3),
        "length": np.array([2, 0, 1]), "recorded": np.arange(2), "poses": np.zeros((2, 3, 7)),
    }  # fmt: skip
    write_arrays(folder / "configurations" / "3.npz", counts)
    write_arrays(folder / "episodes" / "3.npz", flights)
    for name in ("iteration,config,trials,failures,probability", "episode,config,goal,step,x,y"):
        file = "configurations" if name.startswith("iteration") else "trajectories"
        width = name.count(",") + 1
        rows = "".join(",".join(str(n + 0.5 * c) for c in range(width)) + "\n" for n in range(4))
        (former / f"{file}.csv").write_text(f"{name}\n{rows}")
    return folder


def main() -> None:
    """Fuzzes and reports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        found = fuzz(args.inputs, args.seed, sample_run(Path(name) / "run"))
    for (kind, fate), number in sorted(found.items()):
        print(f"{kind:12} {fate:8} {number:6}")
    seconds = time.perf_counter() - started
    print(f"{found.total()} inputs, no traceback, none over {SECONDS} s; {seconds:.0f} s in all")


if __name__ == "__main__":
    main()
