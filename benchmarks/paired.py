"""Which of two trains faster: two checkouts, or two environments with other versions.

    python benchmarks/paired.py A B [--pairs 6] [--iterations 120] [-- OPTIONS OF pecjax train]

A and B are each PYTHON, of an environment that pecjax is installed in, or PYTHON:CHECKOUT, to run what
lies in another folder. Their trainings are run in pairs, now one first and now the other, so that a
machine that drifts drifts for both; what counts is the ratio of a pair. Compilation is left out.
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


def steps_per_second(side: str, cache: Path, options: list[str]) -> float:
    """Of one training, as its summary says."""
    python, _, checkout = side.partition(":")
    paths = {"PYTHONPATH": str(Path(checkout).resolve())} if checkout else {}
    with tempfile.TemporaryDirectory() as home:
        code = "import sys; from pecjax.cli import main; sys.exit(main())"
        command = [str(Path(python).absolute()), "-c", code, "train", *options, "--out", "run"]
        environment = os.environ | {"XDG_CACHE_HOME": str(cache)} | paths
        subprocess.run(command, cwd=home, env=environment, check=True, capture_output=True)
        return json.loads((Path(home) / "run" / "summary.json").read_text())["steps_per_second"]


def main() -> None:
    """Trains in pairs and prints every pair, then the mean ratio with its 95 % interval and the median."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sides", nargs=2, metavar=("A", "B"))
    parser.add_argument("--pairs", type=int, default=6)
    parser.add_argument("--iterations", type=int, default=120)
    words = sys.argv[1:]
    end = words.index("--") if "--" in words else len(words)
    args = parser.parse_args(words[:end])
    options = ["--iterations", str(args.iterations), *words[end + 1 :]]
    ratios = []
    with tempfile.TemporaryDirectory() as caches:
        for pair in range(args.pairs):
            rates = [0.0, 0.0]
            for index in (0, 1) if pair % 2 == 0 else (1, 0):
                rates[index] = steps_per_second(args.sides[index], Path(caches) / str(index), options)
            first, second = rates
            ratios.append(first / second)
            print(f"A {first:9,.0f}  B {second:9,.0f} steps/s  A/B {ratios[-1]:.3f}", flush=True)
    mean = statistics.fmean(np.log(ratios))
    half = stats.t.ppf(0.975, len(ratios) - 1) * stats.sem(np.log(ratios)) if len(ratios) > 1 else np.nan
    low, middle, high = np.exp([mean - half, mean, mean + half])
    print(
        f"A/B: mean {middle:.3f} [{low:.3f}, {high:.3f}], median {statistics.median(ratios):.3f} "
        f"over {len(ratios)} pairs"
    )


if __name__ == "__main__":
    main()
