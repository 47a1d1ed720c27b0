"""A space as a figure: how what its configurations hold is spread, in both parts."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pecjax.envs.rooms.spaces.features import features
from pecjax.envs.rooms.spaces.space import SPLITS, Space
from pecjax.plotting.style import COLUMN, PAGE, legend_below, name_panels, set_title, style_of, styled

_COLUMNS = 3  # of panels
_BINS = 24
_SLANTED = 3  # groups whose names have no room side by side


@styled
def space_figure(space: Space) -> Figure:
    """A histogram of each feature, the shares of the groups first."""
    parts = {split: space.part(split) for split in SPLITS}
    found = {split: features(part.table, part.shortest) for split, part in parts.items()}
    names = (["groups"] if len(space.groups) > 1 else []) + [*found[SPLITS[0]]]
    rows = -(-len(names) // _COLUMNS)
    columns = -(-len(names) // rows)
    figure = Figure((COLUMN if columns == 1 else PAGE, 1.8 * rows + 0.3), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axes, name in zip(panels, names, strict=False):
        if name == "groups":
            _groups(axes, space)
        else:
            _spread(axes, {split: found[split][name] for split in SPLITS if name in found[split]})
        axes.set_xlabel(name[:1].upper() + name[1:])
        axes.set_ylim(0, None)
    for axes in panels[: len(names) : columns]:
        axes.set_ylabel("Share of the part")
    for axes in panels[len(names) :]:
        axes.remove()
    name_panels(panels[: len(names)], [""] * len(names))
    entries = [
        Line2D([], [], **_line(split), label=f"{split.capitalize()}, n = {part.table.size:,} configurations")
        for split, part in parts.items()
    ]
    legend_below(figure, entries)
    set_title(figure, f"Space {space.name}, version {space.version}")
    return figure


def _line(split: str) -> dict:
    return style_of(SPLITS.index(split)) | {"marker": ""}


def _groups(axes: Axes, space: Space) -> None:
    width = 0.38
    for number, split in enumerate(SPLITS):
        shares = np.bincount(space.part(split).group, minlength=len(space.groups))
        places = np.arange(len(space.groups)) + (number - 0.5) * width
        axes.bar(places, shares / shares.sum(), width, color=_line(split)["color"])
    axes.set_xticks(range(len(space.groups)), space.groups, rotation=30 * (len(space.groups) > _SLANTED))


def _spread(axes: Axes, values: dict[str, np.ndarray]) -> None:
    edges = np.histogram_bin_edges(np.concatenate([*values.values()]), _BINS).tolist()
    for split, numbers in values.items():
        look, weights = _line(split), np.full(len(numbers), 1 / len(numbers))
        line = {"color": look["color"], "linestyle": look["linestyle"], "linewidth": 1}
        axes.hist(numbers, edges, weights=weights, histtype="step", **line)
