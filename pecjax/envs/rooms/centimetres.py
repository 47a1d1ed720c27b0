"""Lengths in whole centimetres, which take two bytes each in files."""

from __future__ import annotations

import numpy as np

from pecjax.envs.rooms.maps import FAR_AWAY
from pecjax.errors import InputError

NOWHERE = np.iinfo(np.int16).max  # stands for `FAR_AWAY`, where the corners of boxes without size lie


def to_centimetres(metres: np.ndarray, what: str) -> np.ndarray:
    """Float32 m as int16 cm, from which `to_metres` makes the same numbers.

    Args:
        what: holds them, for the message.

    Raises:
        InputError: some are no whole centimetres, or too large.
    """
    found = np.where(metres == FAR_AWAY, NOWHERE, np.round(100.0 * metres))
    if not np.all(np.abs(found) <= NOWHERE) or np.any(to_metres(found) != metres):
        raise InputError(f"{what} holds lengths that are no whole centimetres; round them")
    return found.astype(np.int16)


def to_metres(centimetres: np.ndarray) -> np.ndarray:
    """Float32 m; 64 bits are rounded but once."""
    metres = (centimetres / 100).astype(np.float32)
    return np.where(centimetres == NOWHERE, np.float32(FAR_AWAY), metres)
