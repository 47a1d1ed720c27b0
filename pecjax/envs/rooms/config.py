"""Configurations of the rooms: their axes, the paper's two sets, and tables from files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from flax import struct

from pecjax.envs.axes import axis, fill
from pecjax.envs.configuration_files import line_of, read_table
from pecjax.errors import InputError

MAX_MAPS = 2**20
MAX_COORDINATE = 1e6  # m; what lies beyond is a typo
MAX_LATENCY = 10  # control steps
OBJECTIVES = ("reach", "hold", "via")
REACH, HOLD, VIA = range(len(OBJECTIVES))


@struct.dataclass
class Configurations:
    """A table of environment configurations, one per row of every leaf.

    A further quantity that varies by episode is a further axis: files of configurations have it at
    once. What has a default may be left out. An optional axis that is left out is None, and the task
    then has nothing of it: without wind and gust there is no air and so no drag, without a heading one
    is drawn.

    Attributes:
        start: (N, 2) m, where the drone begins.
        goal: (N, 2) m, where it must go.
        map_id: (N,) the map that it flies in, by its place among the task's maps from 0 on.
        heading: (N,) rad, where the drone looks at first, from the map's x axis to the left.
        wind: (N, 3) m/s in the world, the mean velocity of the air.
        gust: (N,) m/s, standard deviation of each component of the gusts, which last for
            `NavigationSettings.gust_time` and start anew in every episode.
        payload: (N,) kg, carried at the drone's centre; its inertia grows as its mass does. The
            controller does not know.
        motor_strength: (N,) what the rotors give of what they are asked for.
        visibility: (N,) m, the depth beyond which the camera reads its far end.
        depth_noise: (N,) standard deviation of the depths, as a share of them.
        depth_dropout: (N,) share of the pixels that read the camera's far end, others at every step.
        latency: (N,) control steps by which actions are late.
        objective: (N,) 0 to reach the goal, 1 to stay within the goal radius for
            `NavigationSettings.hold_time`, 2 to reach it by way of the waypoint.
        waypoint: (N, 2) m, within whose goal radius objective 2 must first come.
    """

    start: Any = axis("start_x start_y", unit="m", low=-MAX_COORDINATE, high=MAX_COORDINATE)
    goal: Any = axis("goal_x goal_y", unit="m", low=-MAX_COORDINATE, high=MAX_COORDINATE)
    map_id: Any = axis("map", dtype=np.int32, default=0, low=0, high=MAX_MAPS - 1)
    heading: Any = axis("heading", unit="rad", default=0.0, low=-2 * np.pi, high=2 * np.pi, optional=True)
    wind: Any = axis("wind_x wind_y wind_z", unit="m/s", default=0.0, low=-50, high=50, optional=True)
    gust: Any = axis("gust", unit="m/s", default=0.0, low=0, high=20, optional=True)
    payload: Any = axis("payload", unit="kg", default=0.0, low=0, high=100, optional=True)
    motor_strength: Any = axis("motor_strength", default=1.0, low=0, high=2, optional=True)
    visibility: Any = axis(
        "visibility", unit="m", default=MAX_COORDINATE, low=0, high=MAX_COORDINATE, optional=True
    )
    depth_noise: Any = axis("depth_noise", default=0.0, low=0, high=1, optional=True)
    depth_dropout: Any = axis("depth_dropout", default=0.0, low=0, high=1, optional=True)
    latency: Any = axis(
        "latency", dtype=np.int32, unit="control steps", default=0, low=0, high=MAX_LATENCY, optional=True
    )
    objective: Any = axis(
        "objective", dtype=np.int32, default=REACH, low=0, high=len(OBJECTIVES) - 1, optional=True
    )
    waypoint: Any = axis(
        "waypoint_x waypoint_y",
        unit="m",
        default=0.0,
        low=-MAX_COORDINATE,
        high=MAX_COORDINATE,
        optional=True,
    )

    @property
    def size(self) -> int:
        """N, the number of configurations."""
        return self.start.shape[0]


def draws_on_the_way(config: Configurations) -> bool:
    """Whether episodes in such configurations draw more than how they start."""
    return any(drawn is not None for drawn in (config.gust, config.depth_noise, config.depth_dropout))


def _there_and_back(pairs: list[tuple[tuple[float, float], tuple[float, float]]]) -> Configurations:
    both = np.array([leg for start, goal in pairs for leg in ((start, goal), (goal, start))])
    both = both.astype(np.float32)
    return fill(Configurations(start=both[:, 0], goal=both[:, 1]))


# Table 1 of Jang & Choi (2022): c0, c2, …; each odd row is the reverse of the even row before it.
# The paper prints c15 the same as c14. Every other pair is a reversal and c15 is reported as the
# hardest of all, so we take it for a misprint and read c15 as (3, -2) -> (3, -5).
COORDINATE_SET_1 = _there_and_back([
    ((0, -2), (5, -2)),
    ((-1, 0), (-1, 4)),
    ((-5, 0), (-5, 5)),
    ((0, 5), (5, 5)),
    ((3, 2), (3, 6)),
    ((-5, -5), (-8, -8)),
    ((-7, -8), (-1, -8)),
    ((3, -5), (3, -2)),
    ((0, -2), (-5, -2)),
    ((-8, -2), (6, -2)),
])  # fmt: skip

# Table 2 of Jang & Choi (2022), the hard set: no pair sees its goal from its start.
COORDINATE_SET_2 = _there_and_back([
    ((-7, -8), (-1, -8)),
    ((-8, -2), (6, -2)),
    ((-1, 3), (0, -5)),
    ((0, 5), (5, -2)),
    ((-1, -2), (5, 5)),
    ((0, -1), (-5, 5)),
    ((-6, -6), (-1, -8)),
    ((5, -7), (2, -1)),
    ((6, -1), (3, -6)),
    ((-7, -6), (-1, -8)),
    ((-5, 5), (0, -2)),
    ((-7, 0), (5, 0)),
])  # fmt: skip

_SETS = {"1": COORDINATE_SET_1, "2": COORDINATE_SET_2}


def load_coordinates(name: str | Path, kind: type[Configurations] = Configurations) -> Configurations:
    """Reads a set of coordinates: `1` or `2` for the paper's, else the path of a text file.

    `configuration_files.read_table` says what a file may look like. Without a header a line is start
    x, start y, goal x, goal y in metres.

    Args:
        kind: the class of the table, which may have further axes.

    Raises:
        InputError: no such set or file, or one that is no table of configurations.
    """
    if str(name) in _SETS:
        known = _SETS[str(name)]
        return known if kind is Configurations else fill(kind(known.start, known.goal))
    if not Path(name).is_file():
        raise InputError(f"coordinates '{name}': neither 1 nor 2 nor a file; give one of these")
    return read_table(Path(name), kind)


def leads_to_waypoint(table: Configurations) -> np.ndarray:
    """Whether (N,) the objective is to come by a waypoint."""
    if table.objective is None:
        return np.zeros(np.shape(table.map_id), bool)
    return np.asarray(table.objective) == VIA


def row_name(source: str | Path | None, row: int, kind: type[Configurations]) -> str:
    """What messages call a row of a table of that kind, read from `source`, None for no file."""
    if source is None or str(source) in _SETS:
        return f"configuration {row}"
    return f"{source}, line {line_of(Path(source), kind, row)}: configuration {row}"
