"""A space: configurations to train in, and others of the same kind that no training draws."""

from __future__ import annotations

import hashlib
import json
from typing import NamedTuple

import numpy as np

from pecjax.envs.axes import columns_of, to_columns
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.maps import MapBank
from pecjax.errors import InputError

SPLITS = ("train", "held-out")
_DIGITS = 12  # of a checksum: enough to tell versions apart, and short enough to be read out


class Part(NamedTuple):
    """A table of a space.

    Attributes:
        table: N configurations, all of whose axes are arrays or None.
        group: (N,) int32, the place of each in `Space.groups`.
        shortest: (N,) float32 m, the length of the shortest path to the goal, by way of the waypoint if
            there is one (see `geodesics`).
    """

    table: Configurations
    group: np.ndarray
    shortest: np.ndarray


class Space(NamedTuple):
    """Two parts of one kind.

    Attributes:
        name: as users give it.
        about: one line.
        groups: names of what is reported apart, such as families of maps.
        train: what trainings draw from.
        held_out: what policies are compared in.
        maps: that both parts are flown in; None for the paper's six rooms.
    """

    name: str
    about: str
    groups: tuple[str, ...]
    train: Part
    held_out: Part
    maps: MapBank | None = None

    def part(self, split: str) -> Part:
        """The part of that name.

        Raises:
            InputError: there is none.
        """
        if split not in SPLITS:
            raise InputError(f"split is '{split}'; give {' or '.join(SPLITS)}")
        return self.train if split == SPLITS[0] else self.held_out

    @property
    def version(self) -> str:
        """A checksum of all that is in it: the same name and version are the same configurations."""
        return checksum(self)


def arrays_of(space: Space) -> dict[str, np.ndarray]:
    """All arrays of a space by name."""
    found = {} if space.maps is None else {f"maps/{k}": v for k, v in space.maps._asdict().items()}
    for split in SPLITS:
        part = space.part(split)
        found |= {f"{split}/{column}": values for column, values in to_columns(part.table).items()}
        found |= {f"{split}/group": part.group, f"{split}/shortest": part.shortest}
    return {name: np.ascontiguousarray(array) for name, array in found.items()}


def checksum(space: Space) -> str:
    """The checksum of a space's name, groups and arrays; its description is not part of it."""
    digest = hashlib.sha256(json.dumps([space.name, space.groups]).encode())
    for name, array in sorted(arrays_of(space).items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()[:_DIGITS]


def shared_rows(one: Configurations, other: Configurations) -> np.ndarray:
    """The rows of `one` that are in `other` as well, axis by axis; what a table lacks has its default."""
    known = columns_of(type(one))

    def rows(table: Configurations) -> list[bytes]:
        columns = to_columns(table)
        filled = [columns.get(name, np.full(table.size, about.default)) for name, about in known.items()]
        stacked = np.stack([np.asarray(column, np.float64) for column in filled], axis=1) + 0.0  # no -0
        return [row.tobytes() for row in stacked]

    there = set(rows(other))
    return np.array([number for number, row in enumerate(rows(one)) if row in there], int)


def check_held_out(space: Space) -> None:
    """Makes sure that no configuration is in both parts.

    Raises:
        InputError: the first that is.
    """
    shared = shared_rows(space.held_out.table, space.train.table)
    if shared.size:
        raise InputError(
            f"space {space.name}: {shared.size} held-out configurations are in its training table too, the "
            f"first is row {shared[0]}; a policy could have been trained in them"
        )
