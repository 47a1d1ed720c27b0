"""Features of configurations: numbers by which success in them can be looked at."""

from __future__ import annotations

import numpy as np

from pecjax.envs.axes import axes_of
from pecjax.envs.rooms.config import Configurations

_PLACES = ("start", "goal", "waypoint", "map_id", "heading", "objective")  # whose numbers mean nothing alone


def features(table: Configurations, shortest: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Numbers (N,) of each configuration, by name and unit, of all that vary in the table.

    Args:
        shortest: (N,) m, the lengths of the shortest paths.
    """
    straight = np.linalg.norm(np.asarray(table.goal) - np.asarray(table.start), axis=1)
    found = {"straight distance (m)": straight}
    if shortest is not None:
        found["shortest path (m)"] = np.asarray(shortest)
    for name, about in axes_of(Configurations).items():
        values = getattr(table, name)
        if values is None or name in _PLACES:
            continue
        values, unit = np.asarray(values, np.float64), f" ({about.unit})" if about.unit else ""
        found[name.replace("_", " ") + unit] = np.linalg.norm(values, axis=1) if values.ndim > 1 else values
    return {name: values for name, values in found.items() if np.ptp(values) > 0}
