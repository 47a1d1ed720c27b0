"""Trials and failures of every configuration, at chosen iterations side by side."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pecjax.plotting.style import FAILURES, TRIALS, whole_ticks
from pecjax.studies.statistics import trial_and_failure_ratios

MOST_BARS = 100  # configurations; more have no room for a bar each
SNAPSHOTS = 4  # iterations shown side by side, as in the paper's Fig. 5


def configurations(table: pd.DataFrame, of: str = "", over: str = "") -> Figure:
    """Trial ratio (bars) and failure ratio (line) at chosen iterations (Fig. 5, 9, 11, 13).

    Args:
        table: columns iteration, config, trials and failures; those of several runs are added up.
        of, over: what titles begin with, and what the axis adds.
    """
    chosen = _snapshots(sorted(set(table.iteration)))
    counts = table.groupby(["iteration", "config"])[["trials", "failures"]].sum().reset_index()
    ratios = trial_and_failure_ratios(counts, ["iteration"])
    figure = Figure((3.2 * len(chosen), 3.4), layout="constrained")
    all_axes = figure.subplots(1, len(chosen), sharey=True, squeeze=False)[0]
    twins = []
    for axes, iteration in zip(all_axes, chosen, strict=True):
        twins.append(_trials_and_failures(axes, ratios.loc[ratios.iteration == iteration]))
        twins[-1].tick_params(labelright=iteration == chosen[-1])
        axes.set_title(f"{of}iteration {iteration}", fontsize=9)
    all_axes[0].set_ylabel(f"trial ratio (bars){over}")
    twins[-1].set_ylabel("failure ratio (line)")
    return figure


def _trials_and_failures(axes: Axes, rows: pd.DataFrame) -> Axes:
    """Bars of the trial ratio and a line of the failure ratio by configuration.

    Many configurations are in the order of their failure ratios, and neighbours' trial ratios are averaged.

    Args:
        rows: columns config, trial and failure, of one iteration.

    Returns:
        the axes of the failure ratio, on the right.
    """
    twin = axes.twinx()
    if len(rows) > MOST_BARS:
        rows = rows.sort_values("failure", ascending=False, kind="stable")
        place = np.arange(len(rows))
        averaged = rows.trial.rolling(len(rows) // MOST_BARS, center=True, min_periods=1).mean()
        axes.fill_between(place, averaged, color=TRIALS, linewidth=0)
        twin.plot(place, rows.failure, color=FAILURES, linewidth=1.2)
        twin.set_ylim(0, 1)
        axes.set(xlabel="configurations by failure ratio", xlim=(0, len(rows) - 1), ylim=(0, None))
        axes.locator_params(axis="x", nbins=3)
        return twin
    axes.bar(rows.config, rows.trial, color=TRIALS, label="trial ratio")
    style = {
        "markersize": 3,
        "linewidth": 1,
        "label": "failure ratio",
        "clip_on": False,
    }  # marks at 0 are whole
    twin.plot(rows.config, rows.failure, "o-", color=FAILURES, **style)
    twin.set_ylim(0, 1)
    axes.set(xlabel="configuration c", xlim=(-0.7, rows.config.max() + 0.7))
    whole_ticks(axes)
    return twin


def _snapshots(iterations: list[int]) -> list[int]:
    """Those of the iterations that lie nearest to even parts of the whole."""
    last = iterations[-1]
    wanted = [last * part / SNAPSHOTS for part in range(1, SNAPSHOTS + 1)]
    return sorted({min(iterations, key=lambda i: abs(i - w)) for w in wanted})
