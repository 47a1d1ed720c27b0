"""Kills a training or a study again and again, lets it resume, and compares with one left alone.

    python tests/kills.py [--what training|study] [--kills 50] [--seed 0]

Every process is killed with SIGKILL, at a moment drawn between its start and some time after it has
gone on. `test_kills.py` does the same a few times.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

HUNG_SECONDS = 600  # without going on, whatever else the machine does
KEPT = ("checkpoints", "configurations", "episodes")  # arrays of a training, by iteration
HEAD = """
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import jax

from pecjax.studies import run as study
from pecjax.training import train as training
from pecjax.studies.catalogue import find_study

folder, cache, size = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
jax.config.update("jax_compilation_cache_dir", cache)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
smoke = find_study("fig4", "smoke")
"""
TRAINING = """
settings = replace(
    smoke.run,
    stop=replace(smoke.run.stop, iterations=size),
    evaluation=replace(smoke.run.evaluation, every=4, episodes=3),
    configurations_every=3,
)
if (folder / "states" / f"{size}.npz").exists():
    pass  # the last that a training writes
elif any(folder.glob("states/[0-9]*.npz")):
    training.resume(settings, folder)
else:
    shutil.rmtree(folder, ignore_errors=True)
    training.train(settings, folder, devices=1)
"""
STUDY = """
run = replace(smoke.run, evaluation=replace(smoke.run.evaluation, every=1, episodes=3))
study.run_study(replace(smoke, run=run, seeds=tuple(range(size)), parallel_runs=1), folder)
"""


class Victim(NamedTuple):
    """What is killed.

    Attributes:
        script: resumes what is in the folder, or starts it.
        size: iterations of a training, seeds of a study.
        progress: of a folder, a number that grows as it runs.
        digest: of a folder, sums of all that is left at the end, but for the time it took.
    """

    script: str
    size: int
    progress: Callable[[Path], int]
    digest: Callable[[Path], dict[str, str]]

    def command(self, folder: Path, cache: Path) -> list[str]:
        return [sys.executable, "-c", HEAD + self.script, str(folder), str(cache), str(self.size)]


def sums_of(folder: Path, *patterns: str) -> dict[str, str]:
    paths = sorted(path for pattern in patterns for path in folder.glob(pattern))
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths}


def digest_of_training(folder: Path) -> dict[str, str]:
    found = sums_of(folder, "evaluation.csv", "scene.xml", "coordinates.csv")
    metrics = pd.read_csv(folder / "metrics.csv", dtype=str).drop(columns="seconds")
    found["metrics.csv"] = hashlib.sha256(metrics.to_csv().encode()).hexdigest()
    newest = max((folder / "states").glob("*.npz"), key=lambda path: int(path.stem))
    kept = [path for name in KEPT for path in sorted((folder / name).iterdir())]
    for path in (*kept, newest):
        with np.load(path) as file:
            parts = [file[name].tobytes() for name in file.files if name not in (".seconds", "about")]
        found[str(path.relative_to(folder))] = hashlib.sha256(b"".join(parts)).hexdigest()
    return found


def rows(folder: Path) -> int:
    path = folder / "metrics.csv"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def training(iterations: int) -> Victim:
    return Victim(TRAINING, iterations, rows, digest_of_training)


def study(seeds: int) -> Victim:
    """A study of two samplers; each of its batches is one run of four iterations."""
    return Victim(
        STUDY,
        seeds,
        lambda folder: len(list((folder / "batches").glob("[0-9]*"))),
        lambda folder: sums_of(folder, "*.csv", "study.json", "task-*/*", "batches/*/*", "batches/.*"),
    )


def kill_and_resume(victim: Victim, folder: Path, cache: Path, kills: int, rng: random.Random) -> int:
    """Runs to the end through so many kills; returns how many struck before it."""
    done, errors = 0, folder.with_suffix(".err")
    while True:
        before = victim.progress(folder)
        with errors.open("w") as file:  # a pipe that nobody empties would hold it up
            process = subprocess.Popen(victim.command(folder, cache), stderr=file)
        if done < kills:
            # One in five before it starts at all; the others within two seconds of its first step.
            early, deadline = rng.random() < 0.2, time.monotonic() + HUNG_SECONDS
            while not early and process.poll() is None and victim.progress(folder) <= before:
                assert time.monotonic() < deadline, "made no progress"
                time.sleep(0.005)
            time.sleep(rng.uniform(0, 6 if early else 2) * rng.random())
            if process.poll() is None:
                process.kill()
                process.wait()
                done += 1
                print(f"kill {done} of this run, at {victim.progress(folder)}", flush=True)
                continue
        assert process.wait() == 0, errors.read_text()[-2000:]
        return done


def main() -> None:
    """Runs, kills, compares and reports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--what", choices=("training", "study"), default="training")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng, struck, runs = random.Random(args.seed), 0, 0
    victim = training(400) if args.what == "training" else study(12)
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        whole, cache = home / "whole", home / "cache"
        subprocess.run(victim.command(whole, cache), check=True, stderr=subprocess.DEVNULL)
        wanted = victim.digest(whole)
        while struck < args.kills:
            runs += 1
            folder = home / f"killed-{runs}"
            struck += kill_and_resume(victim, folder, cache, args.kills - struck, rng)
            found = victim.digest(folder)
            assert found == wanted, {name for name in wanted | found if found.get(name) != wanted.get(name)}
            print(f"{struck} kills, {runs} run(s), every file as in the run left alone", flush=True)
    print(f"{struck} kills in {runs} run(s): lost 0")


if __name__ == "__main__":
    main()
