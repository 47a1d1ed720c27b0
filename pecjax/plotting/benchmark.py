"""The figures of the benchmark of samplers: curves, steps to thresholds and where steps went, by space."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pecjax.plotting.seeds import by_condition
from pecjax.plotting.style import (
    COLORS,
    PAGE,
    RATIO_LIMITS,
    legend_below,
    name_panels,
    save,
    style_of,
    styled,
)
from pecjax.storage.tables import read_table
from pecjax.studies.benchmark import CELLS
from pecjax.studies.benchmark_measures import read_cells
from pecjax.studies.measures import BASELINE
from pecjax.studies.shares import mean_shares, read_shares

IN_ROW = 3  # panels
MATTERS = -0.2  # the effect that would matter, see docs/benchmark.md
_LINE = 0.13  # inches, of a condition in a panel


def draw_benchmark(folder: Path) -> list[Path]:
    """Draws `steps` into `figures`; `curves` and `shares`, too, where conditions are few.

    Raises:
        InputError: the folder has no report of the benchmark, or cannot be written.
    """
    cells = read_cells(folder)
    conditions = {condition for table in cells.values() for condition in table.condition}
    compared = read_table(folder / "comparisons.csv", {"value", "low", "high"})
    paths = save(steps(compared), folder / "figures" / "steps") if len(conditions) > 1 else []
    if len(conditions) <= len(COLORS):
        paths += save(curves(cells), folder / "figures" / "curves")
        found = read_shares(folder, cells)
        if found:
            paths += save(shares(found), folder / "figures" / "shares")
    return paths


@styled
def curves(cells: Mapping[str, pd.DataFrame]) -> Figure:
    """Goal ratio of what is compared in each cell against steps: the mean over seeds, and its thresholds."""
    figure, panels = _panels(len(cells), 1.9)
    for axes, (name, table) in zip(panels, cells.items(), strict=True):
        for place, (condition, rows) in enumerate(by_condition(table)):
            mean = rows.groupby("env_steps")[CELLS[name].measured].mean()
            axes.plot(
                mean.index.to_numpy() / 1e6,
                mean.to_numpy(),
                label=condition,
                **style_of(place) | {"marker": ""},
            )
        for at in CELLS[name].thresholds:
            axes.axhline(at, color="0.6", linewidth=0.7, linestyle=":")
        axes.set(xlabel="Environment steps (millions)", ylim=RATIO_LIMITS, xlim=(0, None))
        axes.set_ylabel("Goal ratio" if axes.get_subplotspec().is_first_col() else "")
    name_panels(panels, [_title(name) for name in cells])
    seeds = max(table.seed.nunique() for table in cells.values())
    legend_below(figure, title=f"Mean of up to {seeds} seeds, held out; dotted: the thresholds")
    return figure


@styled
def shares(cells: Mapping[str, pd.DataFrame]) -> Figure:
    """The share of the steps that went to what is learnable in each cell, and to what is out of reach."""
    figure, panels = _panels(len(cells), 1.9)
    for axes, table in zip(panels, cells.values(), strict=True):
        for place, (condition, rows) in enumerate(by_condition(mean_shares(table))):
            style = style_of(place) | {"marker": ""}
            along = rows.env_steps.to_numpy() / 1e6
            axes.plot(along, rows.learnable.to_numpy(), label=condition, **style)
            axes.plot(along, rows.out_of_reach.to_numpy(), **style | {"linewidth": 0.6})
        axes.set(xlabel="Environment steps (millions)", ylim=RATIO_LIMITS, xlim=(0, None))
        axes.set_ylabel("Share of steps" if axes.get_subplotspec().is_first_col() else "")
    name_panels(panels, [_title(name) for name in cells])
    legend_below(figure, title="Bold: learnable; thin: out of reach; the rest is mastered")
    return figure


@styled
def steps(compared: pd.DataFrame) -> Figure:
    """Steps to each cell's middle threshold over those of uniform sampling, with 95 % intervals.

    Args:
        compared: the rows of `benchmark_measures.compare`.
    """
    first = compared[compared["first"]]
    names, cells = list(dict.fromkeys(first.condition)), list(dict.fromkeys(first.cell))
    figure, panels = _panels(len(cells), 0.8 + _LINE * len(names))
    for axes, name in zip(panels, cells, strict=True):
        rows = first[first.cell == name].set_index("condition").reindex(names)
        places = np.arange(len(names))
        values = 100 * rows[["value", "low", "high"]].to_numpy(float)
        error = np.abs(values[:, 1:] - values[:, :1]).T
        mark = {"fmt": "o", "color": COLORS[0], "elinewidth": 0.8, "capsize": 0}
        axes.errorbar(values[:, 0], places, xerr=error, **mark)
        axes.axvline(0, color="0.4", linewidth=0.8)
        axes.axvline(100 * MATTERS, color="0.6", linewidth=0.7, linestyle=":")
        axes.set_yticks(places, names)
        axes.set(xlabel=f"Steps over {BASELINE} (%)", ylim=(len(names) - 0.5, -0.5))
        axes.tick_params(labelleft=axes.get_subplotspec().is_first_col())
        axes.set_xlim(
            100 * max(-0.8, min(first.low.min(), MATTERS)) - 5, 100 * min(1.5, first.high.max()) + 5
        )
    name_panels(panels, [f"{_title(name)}, to {CELLS[name].thresholds[1]:g}" for name in cells])
    return figure


def _panels(number: int, height: float) -> tuple[Figure, list]:
    rows = math.ceil(number / IN_ROW)
    figure = Figure((PAGE, rows * height + 0.3), layout="constrained")
    panels = figure.subplots(rows, min(IN_ROW, number), squeeze=False).ravel().tolist()
    for axes in panels[number:]:
        axes.remove()
    return figure, panels[:number]


def _title(name: str) -> str:
    group = CELLS[name].measured.partition(".")[2]
    return f"{name}, {group}" if group else name
