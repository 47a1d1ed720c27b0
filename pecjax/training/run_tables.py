"""Tables of a finished run that are made of its arrays, or read as version 0.1 wrote them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from pecjax.errors import InputError
from pecjax.storage.tables import read_table
from pecjax.training.run_directory import RunDirectory


def configuration_table(run: RunDirectory) -> pd.DataFrame:
    """Columns iteration, config, trials, failures and probability, a row an iteration and configuration.

    Raises:
        InputError: the run has not got that far.
    """
    columns = ["iteration", "config", "trials", "failures", "probability"]
    if (run.folder / "configurations.csv").is_file():
        return read_table(run.folder / "configurations.csv", set(columns[:-1]))
    parts = []
    for iteration in run.iterations("configurations"):
        arrays = run.arrays("configurations", iteration)
        config = np.arange(len(arrays["trials"]))
        parts.append(pd.DataFrame({"iteration": iteration, "config": config, **arrays}))
    if not parts:
        raise InputError(f"{run.folder / 'configurations'}: missing; train the run to its end")
    return pd.concat(parts, ignore_index=True).loc[:, columns]


def trajectory_table(run: RunDirectory) -> pd.DataFrame:
    """Columns episode, config, success, step, x and y: some flights of the last evaluation, step by step.

    Raises:
        InputError: the run is not finished.
    """
    columns = {"episode", "config", "step", "x", "y"}
    if (run.folder / "trajectories.csv").is_file():
        table = read_table(run.folder / "trajectories.csv", columns | {"goal"})
        return table.rename(columns={"goal": "success"})
    kept = run.iterations("episodes")
    last = run.arrays("episodes", kept[-1]) if kept else {}
    if "paths" not in last:
        raise InputError(f"{run.folder / 'episodes'}: no flights of a finished run; train it to its end")
    parts = []
    for episode, path in zip(last["path_episode"], last["paths"], strict=True):
        length = int(last["length"][episode]) + 1
        flight = {
            "episode": episode,
            "config": last["config_id"][episode],
            "success": last["success"][episode],
        }
        steps = {"step": np.arange(length), "x": path[:length, 0], "y": path[:length, 1]}
        parts.append(pd.DataFrame(flight | steps))
    return pd.concat(parts, ignore_index=True).astype({"success": int})
