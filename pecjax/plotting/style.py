"""Drawing: what all figures share: sizes, fonts, colours, panel letters, saving."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any, ParamSpec

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from pecjax.storage.files import writing

COLUMN, PAGE = 3.3, 7.0  # inches, the widths of a column and of a page
SMALL = 7  # points, of ticks, legends and notes; all else is 8
DPI = 300  # of the PNG

# Paul Tol's "high-contrast" colours and two more: apart in grey, and for colour-blind readers.
BLUE, YELLOW, RED, BLACK, TEAL = COLORS = ("#004488", "#ddaa33", "#bb5566", "#000000", "#44aa99")
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":")
MARKS = ("o", "s", "^", "D", "v", "P", "X")
TRIALS, FAILURES, GOAL, PATH, TIMEOUT = "#9fb8cc", RED, BLACK, BLUE, YELLOW
SMOOTHED_ITERATIONS = 20  # at most, that a smoothed training goal ratio is the mean of
RATIO_LIMITS = (-0.02, 1.02)  # of an axis whose marks at 0 and 1 are to be whole

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: a figure looks the same on every machine
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "figure.titlesize": 8,
    "legend.fontsize": SMALL,
    "legend.title_fontsize": SMALL,
    "legend.frameon": False,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "lines.linewidth": 1.2,
    "lines.markersize": 3,
    "errorbar.capsize": 2,
    "hatch.linewidth": 0.4,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "pdf.fonttype": 42,  # TrueType, which journals ask for
    "svg.hashsalt": "pecjax",  # the same figure has the same bytes
}
_P = ParamSpec("_P")
_ROUND = [1, 2, 5, 10]  # steps between ticks
_LETTER, _LINE, _HANDLE = 0.053, 0.15, 0.5  # inches, of a legend of 7 points
_WRITTEN, _NAMED = (".pdf", ".png"), (".pdf", ".png", ".svg")
_NO_DATE = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def styled(draw: Callable[_P, Figure]) -> Callable[_P, Figure]:
    """Makes a function draw its figure in `STYLE`; matplotlib's own settings stay as they are."""

    @functools.wraps(draw)
    def drawn(*args: _P.args, **kwargs: _P.kwargs) -> Figure:
        with matplotlib.rc_context(STYLE):
            figure = draw(*args, **kwargs)
            # Ticks are made when they are first asked for: here, or later in somebody else's style.
            for axes in figure.axes:
                for each in (axes, *axes.child_axes):
                    each.xaxis.get_major_ticks()
                    each.yaxis.get_major_ticks()
        return figure

    return drawn


def save(figure: Figure, path: Path) -> list[Path]:
    """Writes a figure as PDF, for papers, and as PNG of 300 dpi, for everything else.

    Args:
        path: without an ending, or with one of the two; with `.svg` that is written too.

    Raises:
        InputError: it cannot be written there.
    """
    stem = path.with_suffix("") if path.suffix in _NAMED else path
    endings = (*_WRITTEN, ".svg") if path.suffix == ".svg" else _WRITTEN
    paths = [stem.with_name(stem.name + ending) for ending in endings]
    with writing(stem, "put that right and draw again"), matplotlib.rc_context(STYLE):
        stem.parent.mkdir(parents=True, exist_ok=True)
        for each in paths:
            figure.savefig(each, dpi=DPI, metadata=_NO_DATE.get(each.suffix))
    return paths


def style_of(number: int) -> dict[str, Any]:
    """Colour, dashes and mark of the n-th line; each of 35 has its own colour and mark."""
    return {
        "color": COLORS[number % len(COLORS)],
        "linestyle": DASHES[number % len(DASHES)],
        "marker": MARKS[number % len(MARKS)],
    }


def name_panels(panels: Sequence[Axes], titles: Iterable[str]) -> None:
    """Gives panels their titles, and letters where there are several of them."""
    for number, (axes, title) in enumerate(zip(panels, titles, strict=True)):
        turn, place = divmod(number, 26)
        letter = chr(ord("a") + turn - 1) * (turn > 0) + chr(ord("a") + place)
        axes.set_title(f"({letter}) {title}".strip() if len(panels) > 1 else title, loc="left")


def drop_inner_labels(panels: Sequence[Axes], columns: int) -> None:
    """Keeps the labels of the lowest panel of each column and of the first of each row; call it last."""
    for place, axes in enumerate(panels):
        below = place + columns < len(panels)
        axes.tick_params(labelbottom=not below, labelleft=place % columns == 0)
        if below:
            axes.set_xlabel("")
        if place % columns:
            axes.set_ylabel("")


def legend_below(figure: Figure, entries: Sequence[Artist] | None = None, title: str = "") -> None:
    """A legend that takes its room from below the axes; the figure grows by it.

    Args:
        entries: with labels. (default: those of all panels, each label once)
    """
    if entries is None:
        found = [axes.get_legend_handles_labels() for axes in figure.axes]
        by_label = {label: handle for pairs in found for handle, label in zip(*pairs, strict=True)}
        labels, handles = list(by_label), list(by_label.values())
    else:
        handles, labels = list(entries), [str(entry.get_label()) for entry in entries]
    width = figure.get_figwidth()
    letters = int((width - _HANDLE) / _LETTER)
    labels = [fill(label, letters) for label in labels]
    title = "\n".join(fill(line, letters) for line in title.splitlines())
    longest = max(len(line) for label in labels for line in label.splitlines())
    rows = -(-len(labels) // max(1, int(width / (_HANDLE + _LETTER * longest))))
    lines = rows * max(label.count("\n") + 1 for label in labels) + len(title.splitlines())
    figure.set_figheight(figure.get_figheight() + _LINE * lines)
    columns = -(-len(labels) // rows)
    figure.legend(handles, labels, title=title or None, loc="outside lower center", ncols=columns)


def set_title(figure: Figure, words: str) -> None:
    """What the whole figure is of, at its upper left."""
    figure.suptitle(words, x=0.01, ha="left", fontsize=STYLE["figure.titlesize"])


def name_place(axes: Axes, name: str, place: tuple[float, float]) -> None:
    """Writes a name beside a place, with a white edge that keeps it legible on a picture."""
    edge = [withStroke(linewidth=1.6, foreground="white")]
    style = {"fontsize": SMALL - 1, "path_effects": edge, "zorder": 6}
    axes.annotate(name, place, textcoords="offset points", xytext=(3, 4), **style)


def by_iteration(axes: Axes) -> None:
    """An x axis of iterations, which are whole, and a grid."""
    axes.set_xlabel("Training iteration")
    whole_ticks(axes)
    axes.grid(True)


def whole_ticks(axes: Axes) -> None:
    """Ticks of the x axis at whole numbers only: iterations and configurations have no others."""
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=_ROUND, integer=True, min_n_ticks=1))


def smoothed(ratios: pd.Series) -> pd.Series:
    """Goal ratios (T,) as means of `window` iterations around each: one that trails would show them late."""
    means = ratios.rolling(window(len(ratios)), center=True, min_periods=1).mean()
    return pd.Series(means, ratios.index)


def window(iterations: int) -> int:
    """How many of so many iterations `smoothed` takes the mean of: a fifth, within limits."""
    return int(np.clip(iterations // 5, 2, SMOOTHED_ITERATIONS))


def steps_unit(most: float) -> tuple[float, str]:
    """The unit in which so many environment steps have short ticks, and how a label names it."""
    if most >= 1e6:
        return 1e6, " (millions)"
    return (1e3, " (thousands)") if most >= 1e4 else (1.0, "")


def steps_axis(axes: Axes, batch: float) -> None:
    """An axis of environment steps above one of iterations of `batch` steps; call it last."""
    unit, of_unit = steps_unit(axes.get_xlim()[1] * batch)
    to_steps: tuple[Callable, Callable] = (lambda i: i * batch / unit, lambda s: s / batch * unit)
    axes.secondary_xaxis("top", functions=to_steps).set_xlabel(f"Environment steps{of_unit}")
