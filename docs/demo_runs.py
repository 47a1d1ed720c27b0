"""Makes the runs in pecjax/demos of trained ones: their policies, their last evaluation, flown anew.

    pecjax train --task.space rooms-pairs --iterations 732 --out runs/demo
    pecjax train --out runs/demo-set-1
    pecjax train --coordinates 2 --out runs/demo-set-2
    python docs/demo_runs.py runs/demo runs/demo-set-1 runs/demo-set-2

Left out are what the optimizer remembers, states to resume from, and all checkpoints but the last.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import jax
import numpy as np

from pecjax.storage.arrays import write_arrays
from pecjax.training.demos import DEMOS, FOLDER
from pecjax.training.load import open_run
from pecjax.training.rows import episode_arrays, recording_arrays

TABLES = (
    "config.json",
    "scene.xml",
    "coordinates.csv",
    "space.npz",
    "evaluation.csv",
    "summary.json",
)
HISTORIES = 20  # iterations whose probabilities are kept
FLIGHTS = 50


def make_demo(run: Path, demo: Path) -> None:
    """Copies what is needed to fly and to watch the policy of a run."""
    trained = open_run(run)
    result = trained.evaluator()()
    chosen = np.linspace(0, len(result.success) - 1, FLIGHTS).astype(int)
    shutil.rmtree(demo, ignore_errors=True)
    demo.mkdir(parents=True)
    for name in TABLES:
        if (run / name).exists():
            shutil.copy(run / name, demo / name)
    last = f"{trained.iteration}.npz"
    # Zeros take no room in the wheel, which is compressed.
    forgotten = jax.tree.map(np.zeros_like, trained.learner.optimizer)
    write_arrays(demo / "checkpoints" / last, trained.learner._replace(optimizer=forgotten))
    write_arrays(demo / "episodes" / last, episode_arrays(result) | recording_arrays(result, chosen))
    there = sorted((run / "configurations").glob("*.npz"), key=lambda path: int(path.stem))
    (demo / "configurations").mkdir()
    for place in np.unique(np.linspace(0, len(there) - 1, HISTORIES).astype(int)):
        shutil.copy(there[place], demo / "configurations")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        assert Path(name).name in DEMOS, f"{name} is none of {DEMOS}"
        make_demo(Path(name), FOLDER / Path(name).name)
