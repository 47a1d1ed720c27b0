"""Ranges of settings' numbers."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

from pecjax.errors import InputError

ABOVE_0 = sys.float_info.min
Range = tuple[float, float]
ANY = (0.0, math.inf)  # that is not negative
SOME = (ABOVE_0, math.inf)
SHARE = (0.0, 1.0)


def check_ranges(settings: Any, ranges: Mapping[str, Range]) -> None:
    """Makes sure that each of these numbers is in its range, ends included; None is in any.

    Raises:
        InputError: the first that is not.
    """
    for name, (least, most) in ranges.items():
        value = getattr(settings, name)
        if value is not None and not least <= value <= most:
            low = "more than 0" if least == ABOVE_0 else f"{least:g}"
            wanted = (
                f"{low} to {most:g}" if most < math.inf else low if least == ABOVE_0 else f"{low} or more"
            )
            raise InputError(f"{name.replace('_', '-')} is {value:g}; give {wanted}")
