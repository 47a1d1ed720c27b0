"""Drawing: what all figures share: colours, reading tables, saving pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pecjax.storage.files import writing

# Colours that stay apart in grey (Okabe & Ito).
TRIALS, FAILURES, GOAL, PATH = "#9fb8cc", "#a0330f", "#00573f", "#1f5f99"
SMOOTHED_ITERATIONS = 20  # that a smoothed training goal ratio is the mean of
RATIO_LIMITS = (-0.02, 1.02)  # of an axis whose marks at 0 and 1 are to be whole

matplotlib.rcParams["svg.hashsalt"] = "pecjax"


def save(figure: Figure, path: Path) -> list[Path]:
    """Writes a figure as PNG and SVG; `path` is without their endings.

    Raises:
        InputError: it cannot be written there.
    """
    paths = [path.with_name(path.name + suffix) for suffix in (".png", ".svg")]
    with writing(path, "put that right and draw again"):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(paths[0], dpi=150)
        figure.savefig(paths[1], metadata={"Date": None})
    return paths


def whole_ticks(axes: Axes) -> None:
    """Ticks of the x axis at whole numbers only: iterations and configurations have no others."""
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def steps_unit(most: float) -> tuple[float, str]:
    """The unit in which so many environment steps have short ticks, and how a label names it."""
    if most >= 1e6:
        return 1e6, " (millions)"
    return (1e3, " (thousands)") if most >= 1e4 else (1.0, "")


def steps_axis(axes: Axes, batch: float) -> None:
    """An axis of environment steps above one of iterations of `batch` steps; call it last."""
    unit, of_unit = steps_unit(axes.get_xlim()[1] * batch)
    to_steps: tuple[Callable, Callable] = (lambda i: i * batch / unit, lambda s: s / batch * unit)
    axes.secondary_xaxis("top", functions=to_steps).set_xlabel(f"environment steps{of_unit}")
