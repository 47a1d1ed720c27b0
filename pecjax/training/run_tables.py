"""Tables of a finished run that are made of its arrays, or read as version 0.1 wrote them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from pecjax.errors import InputError
from pecjax.storage.tables import read_table
from pecjax.training.run_arrays import last_recording, run_arrays
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
        with run_arrays(run, "configurations", iteration) as arrays:
            config = np.arange(len(arrays["trials"]))
            table = pd.DataFrame({"iteration": iteration, "config": config, **arrays})[columns]
            parts.append(table.astype({"trials": int, "failures": int, "probability": float}))
    if not parts:
        raise InputError(f"{run.folder / 'configurations'}: missing; train the run to its end")
    return pd.concat(parts, ignore_index=True)


def trajectory_table(run: RunDirectory) -> pd.DataFrame:
    """Columns episode, config, success, step, x and y: some episodes of the last evaluation, step by step.

    Raises:
        InputError: the run is not finished.
    """
    columns = {"episode", "config", "step", "x", "y"}
    if (run.folder / "trajectories.csv").is_file():
        table = read_table(run.folder / "trajectories.csv", columns | {"goal"})
        return table.rename(columns={"goal": "success"})
    parts = []
    with last_recording(run) as last:
        for episode, path in zip(last["recorded"], last["poses"], strict=True):
            length = int(last["length"][episode]) + 1
            if len(path[:length]) != length:
                raise ValueError(f"episode {episode} has no {length} poses")
            about = {
                "episode": episode,
                "config": last["config_id"][episode],
                "success": last["success"][episode],
            }
            steps = {"step": np.arange(length), "x": path[:length, 0], "y": path[:length, 1]}
            parts.append(pd.DataFrame(about | steps))
        kinds = {"episode": int, "config": int, "success": int, "x": float, "y": float}
        return pd.concat(parts, ignore_index=True).astype(kinds)
