"""Extras: libraries that pecjax needs for one thing only, and is installed without."""

from __future__ import annotations

import importlib
import importlib.util
from types import ModuleType

from pecjax.errors import InputError


def require(library: str, *, extra: str) -> ModuleType:
    """The library, which an extra of pecjax installs.

    Raises:
        InputError: it is missing.
    """
    spec = importlib.util.find_spec(library)
    # A folder of that name on the path is taken for a package without a file of its own.
    if spec is None or spec.origin is None:
        raise InputError(f"the library {library} is missing; pip install 'pecjax[{extra}]'")
    return importlib.import_module(library)
