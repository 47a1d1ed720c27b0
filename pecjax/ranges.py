"""Ranges of settings' numbers."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

from pecjax.errors import InputError

Range = tuple[float, float]
ABOVE_0 = sys.float_info.min
POSITIVE = (ABOVE_0, math.inf)
NOT_NEGATIVE = (0.0, math.inf)
SHARE = (0.0, 1.0)


def check_ranges(settings: Any, ranges: Mapping[str, Range]) -> None:
    """Makes sure that each of these numbers is in its range, ends included; None is in any.

    Raises:
        InputError: the first that is not.
    """
    for name, (least, most) in ranges.items():
        value = getattr(settings, name)
        if value is not None and not least <= value <= most:
            raise InputError(f"{name.replace('_', '-')} is {value:g}; give {_in_words(least, most)}")


def _in_words(least: float, most: float) -> str:
    if least == ABOVE_0:
        return "more than 0" if most == math.inf else f"more than 0, at most {most:g}"
    return f"{least:g} or more" if most == math.inf else f"{least:g} to {most:g}"
