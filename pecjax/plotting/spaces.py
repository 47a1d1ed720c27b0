"""A space as a figure: how what its configurations hold is spread, in both parts."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pecjax.envs.rooms.spaces.features import features
from pecjax.envs.rooms.spaces.space import SPLITS, Space
from pecjax.plotting.style import FAILURES, PATH

_COLUMNS = 3  # of panels
_BINS = 24
_COLORS: dict[str, str] = dict(zip(SPLITS, (PATH, FAILURES), strict=True))


def space_figure(space: Space) -> Figure:
    """A histogram of each feature, the shares of the groups first."""
    parts = {split: space.part(split) for split in SPLITS}
    found = {split: features(part.table, part.shortest) for split, part in parts.items()}
    names = (["groups"] if len(space.groups) > 1 else []) + [*found[SPLITS[0]]]
    rows, columns = -(-len(names) // _COLUMNS), min(len(names), _COLUMNS)
    figure = Figure((3.4 * columns, 2.6 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, name in zip(panels, names, strict=False):
        if name == "groups":
            _groups(axes, space)
        else:
            _spread(axes, {split: found[split][name] for split in SPLITS if name in found[split]})
            axes.set_xlabel(name)
        axes.tick_params(labelsize=8)
    for row in range(rows):
        panels[row * columns].set_ylabel("share of the part")
    for axes in panels[len(names) :]:
        axes.remove()
    sizes = ", ".join(f"{split}: {part.table.size:,}" for split, part in parts.items())
    figure.suptitle(f"{space.name} {space.version} ({sizes})", fontsize=10)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    return figure


def _groups(axes: Axes, space: Space) -> None:
    width = 0.38
    for number, split in enumerate(SPLITS):
        shares = np.bincount(space.part(split).group, minlength=len(space.groups))
        places = np.arange(len(space.groups)) + (number - 0.5) * width
        axes.bar(places, shares / shares.sum(), width, color=_COLORS[split], label=split)
    axes.set_xticks(range(len(space.groups)), space.groups, rotation=30 if len(space.groups) > 4 else 0)


def _spread(axes: Axes, values: dict[str, np.ndarray]) -> None:
    edges = np.histogram_bin_edges(np.concatenate([*values.values()]), _BINS).tolist()
    for split, numbers in values.items():
        weights = np.full(len(numbers), 1 / len(numbers))
        axes.hist(numbers, edges, weights=weights, histtype="step", color=_COLORS[split], label=split)
