"""Which of two trains, or compiles, faster: two checkouts, or two environments with other versions.

    python benchmarks/paired.py A B [--pairs 6] [--iterations 120] [--compile] [--together]
        [-- OPTIONS OF pecjax train]

A and B are each PYTHON, of an environment that pecjax is installed in, or PYTHON:CHECKOUT, to run what
lies in another folder. Their trainings are run in pairs, now one first and now the other, so that a
machine that drifts drifts for both; what counts is the ratio of a pair. Compilation is left out, or with
--compile is all that counts: its seconds, with an empty cache each time. With --together the two of a
pair run at the same time, each on one device and one core (Linux only), and change cores from pair to
pair: what slows the machine down slows both.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from scipy import stats


def figure_of(name: str, side: str, cache: Path, options: list[str], cores: set[int]) -> float:
    """One of the figures in the summary of one training, on these cores where any are given."""
    python, _, checkout = side.partition(":")
    paths = {"PYTHONPATH": str(Path(checkout).resolve())} if checkout else {}
    with tempfile.TemporaryDirectory() as home:
        code = "import sys; from pecjax.cli import main; sys.exit(main())"
        command = [str(Path(python).absolute()), "-c", code, "train", *options, "--out", "run"]
        environment = os.environ | {"XDG_CACHE_HOME": str(cache)} | paths
        process = subprocess.Popen(
            command, cwd=home, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        if cores:
            os.sched_setaffinity(process.pid, cores)
        _, complaint = process.communicate()
        if process.returncode:
            raise SystemExit(f"{' '.join(command)}: {complaint}")
        return json.loads((Path(home) / "run" / "summary.json").read_text())[name]


def main() -> None:
    """Trains in pairs and prints every pair, then the mean ratio with its 95 % interval and the median."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sides", nargs=2, metavar=("A", "B"))
    parser.add_argument("--pairs", type=int, default=6)
    parser.add_argument("--iterations", type=int, default=120)
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--together", action="store_true")
    words = sys.argv[1:]
    end = words.index("--") if "--" in words else len(words)
    args = parser.parse_args(words[:end])
    options = ["--iterations", str(args.iterations), *words[end + 1 :]]
    if args.together:
        options += ["--devices", "1"]
    name, unit = ("compile_seconds", "s") if args.compile else ("steps_per_second", "steps/s")
    ratios = []
    with tempfile.TemporaryDirectory() as caches:
        for pair in range(args.pairs):
            order = (0, 1) if pair % 2 == 0 else (1, 0)
            runs = {}
            with ThreadPoolExecutor(2 if args.together else 1) as pool:
                for core, index in enumerate(order):
                    cache = Path(caches) / (f"{index}-{pair}" if args.compile else str(index))
                    cores = {core} if args.together else set()
                    runs[index] = pool.submit(figure_of, name, args.sides[index], cache, options, cores)
            first, second = runs[0].result(), runs[1].result()
            ratios.append(first / second)
            print(f"A {first:9,.1f}  B {second:9,.1f} {unit}  A/B {ratios[-1]:.3f}", flush=True)
    mean = statistics.fmean(np.log(ratios))
    half = stats.t.ppf(0.975, len(ratios) - 1) * stats.sem(np.log(ratios)) if len(ratios) > 1 else np.nan
    low, middle, high = np.exp([mean - half, mean, mean + half])
    print(
        f"A/B: mean {middle:.3f} [{low:.3f}, {high:.3f}], median {statistics.median(ratios):.3f} "
        f"over {len(ratios)} pairs"
    )


if __name__ == "__main__":
    main()
