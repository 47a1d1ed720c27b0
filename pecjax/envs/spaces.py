"""Spaces: what observations and actions look like."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Box:
    """Real numbers: an array of this shape, each between two bounds.

    Attributes:
        shape: of one observation or action. An observation of two axes (H, W), or three (H, W, C), is
            an image.
        low, high: the bounds; infinite where there are none.
    """

    shape: tuple[int, ...]
    low: float = -np.inf
    high: float = np.inf

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return math.prod(self.shape)

    @property
    def is_image(self) -> bool:
        """Whether neighbours in it are neighbours in what is seen."""
        return len(self.shape) in (2, 3)


@dataclass(frozen=True)
class Discrete:
    """One of several choices: a () int32 from 0 to `num_actions` - 1."""

    num_actions: int
