"""Options: how those are shown that have no value unless one is given."""

from __future__ import annotations

from typing import Annotated, TypeVar

import tyro

T = TypeVar("T")

# Its description says what happens without it, where tyro would say "(default: None)"; and `None` is
# nothing that can be typed.
Option = Annotated[T | None, tyro.conf.DisallowNone, tyro.conf.arg(help_behavior_hint="")]
