"""The map from above for the terminal, and its walls as lines."""

from __future__ import annotations

import numpy as np

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.map_file import ENDLESS, Map

_WIDTH, _HEIGHT = 72, 32  # characters at most
FEW_WALLS = 20


def text_map(one: Map, table: Configurations, radius: float, flight_height: float) -> list[str]:
    """What the drone would hit at its flight height, with the starts and goals of map 0."""
    low, high = one.bounds
    # A character is twice as high as it is wide.
    width = max((high[0] - low[0]) / _WIDTH, (high[1] - low[1]) / (2 * _HEIGHT))
    cell = np.array([width, 2 * width])
    columns, rows = np.maximum(np.ceil((high - low) / cell - 1e-6).astype(int), 1)
    drawn = np.full((rows, columns), ".")
    for lower, upper in zip(one.lower, one.upper, strict=True):
        if lower[2] - radius <= flight_height <= upper[2] + radius:
            left, bottom = np.floor((np.clip(lower[:2], low, high) - low) / cell + 1e-6).astype(int)
            right, top = np.ceil((np.clip(upper[:2], low, high) - low) / cell - 1e-6).astype(int)
            drawn[bottom:top, left:right] = "#"
    here = np.asarray(table.map_id) == 0
    for mark, places in (("G", np.asarray(table.goal)[here]), ("S", np.asarray(table.start)[here])):
        column, row = np.clip(((places - low) / cell).astype(int), 0, (columns - 1, rows - 1)).T
        taken = "G" if mark == "S" else "S"
        drawn[row, column] = np.where(drawn[row, column] == taken, "*", mark)
    legend = f"# wall at {flight_height:g} m, S start, G goal, * both; {cell[0]:.2g} by {cell[1]:.2g} m each"
    return [*("".join(row) for row in drawn[::-1]), legend]


def wall_lines(one: Map) -> list[str]:
    """A line for each of few walls: its name, and from where to where it reaches in metres."""
    if len(one.names) > FEW_WALLS:
        return []
    width = max(map(len, one.names))
    return [
        f"  {name:<{width}}"
        + "".join(f"  {axis} {_range(*ends)}" for axis, *ends in zip("xyz", lower, upper, strict=True))
        for name, lower, upper in zip(one.names, one.lower, one.upper, strict=True)
    ]


def _range(low: float, high: float) -> str:
    shown = ["without end" if abs(end) == ENDLESS else f"{end:.6g}" for end in (low, high)]
    return f"{f'{shown[0]} to {shown[1]}':<14}"
