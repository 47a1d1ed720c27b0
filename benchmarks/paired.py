"""Which of two trains, or compiles, faster: two checkouts, or two environments with other versions.

    python benchmarks/paired.py A B [--pairs 6] [--iterations 120] [--compile] [-- OPTIONS OF pecjax train]

A and B are each PYTHON, of an environment that pecjax is installed in, or PYTHON:CHECKOUT, to run what
lies in another folder. Their trainings are run in pairs, now one first and now the other, so that a
machine that drifts drifts for both; what counts is the ratio of a pair. Compilation is left out, or with
--compile is all that counts: its seconds, with an empty cache each time.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy import stats


def figure_of(name: str, side: str, cache: Path, options: list[str]) -> float:
    """One of the figures in the summary of one training."""
    python, _, checkout = side.partition(":")
    paths = {"PYTHONPATH": str(Path(checkout).resolve())} if checkout else {}
    with tempfile.TemporaryDirectory() as home:
        code = "import sys; from pecjax.cli import main; sys.exit(main())"
        command = [str(Path(python).absolute()), "-c", code, "train", *options, "--out", "run"]
        environment = os.environ | {"XDG_CACHE_HOME": str(cache)} | paths
        subprocess.run(command, cwd=home, env=environment, check=True, capture_output=True)
        return json.loads((Path(home) / "run" / "summary.json").read_text())[name]


def main() -> None:
    """Trains in pairs and prints every pair, then the mean ratio with its 95 % interval and the median."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sides", nargs=2, metavar=("A", "B"))
    parser.add_argument("--pairs", type=int, default=6)
    parser.add_argument("--iterations", type=int, default=120)
    parser.add_argument("--compile", action="store_true")
    words = sys.argv[1:]
    end = words.index("--") if "--" in words else len(words)
    args = parser.parse_args(words[:end])
    options = ["--iterations", str(args.iterations), *words[end + 1 :]]
    name, unit = ("compile_seconds", "s") if args.compile else ("steps_per_second", "steps/s")
    ratios = []
    with tempfile.TemporaryDirectory() as caches:
        for pair in range(args.pairs):
            found = [0.0, 0.0]
            for index in (0, 1) if pair % 2 == 0 else (1, 0):
                cache = Path(caches) / (f"{index}-{pair}" if args.compile else str(index))
                found[index] = figure_of(name, args.sides[index], cache, options)
            first, second = found
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
