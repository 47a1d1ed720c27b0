"""Kills a training again and again at random moments, lets it go on, and compares with one left alone.

    python tests/kills.py [--kills 50] [--seed 0]

Every process is killed with SIGKILL, at a moment drawn between its start and some time after it has
gone on training. `test_kills.py` does the same a few times.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

HUNG_SECONDS = 600  # without going on, whatever else the machine does
TRAIN = """
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import jax

from pecjax.experiments import training
from pecjax.experiments.studies import find_study

jax.config.update("jax_compilation_cache_dir", sys.argv[2])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
settings = replace(
    find_study("fig4", "smoke").run,
    iterations=int(sys.argv[3]), evaluate_every=4, evaluation_episodes=3, configurations_every=3,
)
folder = Path(sys.argv[1])
if any(folder.glob("states/[0-9]*.npz")):
    training.resume(settings, folder)
else:
    shutil.rmtree(folder, ignore_errors=True)
    training.train(settings, folder, devices=1)
"""


def command(folder: Path, cache: Path, iterations: int) -> list[str]:
    return [sys.executable, "-c", TRAIN, str(folder), str(cache), str(iterations)]


def digest(folder: Path) -> dict[str, str]:
    """Of everything that a run leaves, but for the time it took."""
    found = {}
    for name in ("configurations.csv", "evaluation.csv", "trajectories.csv"):
        found[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    metrics = pd.read_csv(folder / "metrics.csv", dtype=str).drop(columns="seconds")
    found["metrics.csv"] = hashlib.sha256(metrics.to_csv().encode()).hexdigest()
    newest = max((folder / "states").glob("*.npz"), key=lambda path: int(path.stem))
    for path in (*sorted((folder / "checkpoints").glob("*.npz")), newest):
        with np.load(path) as file:
            parts = [file[name].tobytes() for name in file.files if name not in (".seconds", "about")]
        found[str(path.relative_to(folder))] = hashlib.sha256(b"".join(parts)).hexdigest()
    return found


def rows(folder: Path) -> int:
    path = folder / "metrics.csv"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def kill_and_go_on(folder: Path, cache: Path, iterations: int, kills: int, rng: random.Random) -> int:
    """Trains to the end through so many kills; returns how many struck before it."""
    done, said = 0, folder.with_suffix(".err")
    while not (folder / "states" / f"{iterations}.npz").exists():  # the last that a training writes
        with said.open("w") as file:  # a pipe that nobody empties would hold it up
            process = subprocess.Popen(command(folder, cache, iterations), stderr=file)
        if done < kills:
            # One in five before it trains at all; the others within two seconds of its first new row.
            early, before, deadline = rng.random() < 0.2, rows(folder), time.monotonic() + HUNG_SECONDS
            while not early and process.poll() is None and rows(folder) <= before:
                assert time.monotonic() < deadline, "did not go on"
                time.sleep(0.005)
            time.sleep(rng.uniform(0, 6 if early else 2) * rng.random())
            if process.poll() is None:
                process.kill()
                process.wait()
                done += 1
                print(f"kill {done} of this run, at {rows(folder)} rows", flush=True)
                continue
        assert process.wait() == 0, said.read_text()[-2000:]
    return done


def main() -> None:
    """Runs, kills, compares and reports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = random.Random(args.seed)
    struck = runs = 0
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        subprocess.run(command(home / "whole", home / "cache", 400), check=True, stderr=subprocess.DEVNULL)
        wanted = digest(home / "whole")
        while struck < args.kills:
            runs += 1
            folder = home / f"killed-{runs}"
            struck += kill_and_go_on(folder, home / "cache", 400, args.kills - struck, rng)
            found = digest(folder)
            assert found == wanted, {name for name in wanted if found.get(name) != wanted[name]}
            print(f"{struck} kills, {runs} run(s), every file as in the run left alone", flush=True)
    print(f"{struck} kills in {runs} run(s): lost 0")


if __name__ == "__main__":
    main()
