"""Trials and failures of every configuration, at chosen iterations side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pecjax.plotting.style import (
    FAILURES,
    PAGE,
    TRIALS,
    legend_below,
    name_panels,
    set_title,
    styled,
    whole_ticks,
)
from pecjax.studies.statistics import trial_and_failure_ratios

MOST_BARS = 100  # configurations; more have no room for a bar each
UNIFORM: dict[str, Any] = {"color": "black", "linewidth": 0.7, "linestyle": ":"}
SNAPSHOTS = 4  # iterations shown side by side, as in the paper's Fig. 5


@styled
def configurations(table: pd.DataFrame, of: str = "") -> Figure:
    """Trial ratio and failure ratio at chosen iterations, one above the other (Fig. 5, 9, 11, 13).

    Args:
        table: columns iteration, config, trials and failures; those of several runs are added up.
        of: whose they are, where that is not said elsewhere.
    """
    chosen = snapshots(sorted(set(table.iteration)))
    counts = table.groupby(["iteration", "config"])[["trials", "failures"]].sum().reset_index()
    ratios = trial_and_failure_ratios(counts, ["iteration"])
    figure = Figure((PAGE, 3.2), layout="constrained")
    panels = figure.subplots(2, len(chosen), sharex=True, sharey="row", squeeze=False)
    for (above, below), iteration in zip(panels.T, chosen, strict=True):
        _bars(above, below, ratios.loc[ratios.iteration == iteration])
    trials = counts.groupby("iteration").trials.sum()
    name_panels(panels[0], [f"Iteration {at}\nn = {trials[at]:,} trials" for at in chosen])
    panels[0, 0].set(ylabel="Trial ratio", ylim=(0, None))
    panels[1, 0].set(ylabel="Failure ratio", ylim=(0, 1))
    figure.align_ylabels()
    uniform = f"Uniform share, 1/{table.config.nunique():,}"
    entries = [
        Patch(color=TRIALS, label="Share of all trials since the beginning"),
        Patch(color=FAILURES, label="Share of a configuration's trials that failed"),
        Line2D([], [], **UNIFORM, label=uniform),
    ]
    legend_below(figure, entries)
    if of:
        set_title(figure, of)
    return figure


def _bars(above: Axes, below: Axes, rows: pd.DataFrame) -> None:
    """A bar for each configuration; many are in the order of their failure ratios, without gaps.

    Of many the trial ratio is the mean of neighbours.

    Args:
        rows: columns config, trial and failure, of one iteration.
    """
    if len(rows) > MOST_BARS:
        rows = rows.sort_values("failure", ascending=False, kind="stable")
        place = np.arange(len(rows))
        averaged = rows.trial.rolling(len(rows) // MOST_BARS, center=True, min_periods=1).mean()
        above.fill_between(place, averaged, color=TRIALS, linewidth=0)
        below.fill_between(place, rows.failure, color=FAILURES, linewidth=0)
        below.set(xlabel="Configurations,\nby failure ratio", xlim=(0, len(rows) - 1))
        below.locator_params(axis="x", nbins=3)
    else:
        above.bar(rows.config, rows.trial, color=TRIALS)
        below.bar(rows.config, rows.failure, color=FAILURES)
        last = rows.config.max()
        below.set(xlabel="Configuration", xlim=(-0.7, last + 0.7))
        whole_ticks(below)
        below.set_xticks([tick for tick in below.get_xticks() if 0 <= tick <= last])
    above.axhline(1 / len(rows), **UNIFORM)
    for axes in (above, below):
        axes.grid(True, axis="y")


def snapshots(iterations: list[int]) -> list[int]:
    """At most `SNAPSHOTS` of the iterations, as far from each other as they can be; the last is one."""
    if len(iterations) <= SNAPSHOTS:
        return iterations
    stride = (len(iterations) - 1) // (SNAPSHOTS - 1)
    return iterations[::-stride][:SNAPSHOTS][::-1]
