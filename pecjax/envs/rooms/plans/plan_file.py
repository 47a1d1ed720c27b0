"""Files of plans: all boxes of all plans in whole centimetres, as one .npz file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pecjax.envs.rooms.centimetres import NOWHERE, to_centimetres, to_metres
from pecjax.envs.rooms.plans.families import MAX_BOXES, MAX_SIZE
from pecjax.envs.rooms.plans.generate import MAX_PLANS
from pecjax.envs.rooms.plans.plans import Plans
from pecjax.errors import InputError
from pecjax.storage.arrays import read_plain_arrays, write_arrays
from pecjax.storage.files import writing

_MAX_CORNER = 100 * MAX_SIZE + 100  # cm
_MAX_NAMES = 1000
# Type and shape of each array, M being the number of plans, W that of boxes and F that of families.
_ARRAYS: dict[str, tuple[type[np.generic], tuple[Any, ...]]] = {
    "lower": (np.int16, ("M", "W", 3)),
    "upper": (np.int16, ("M", "W", 3)),
    "bounds": (np.int16, ("M", 2, 2)),
    "start": (np.int16, ("M", 2)),
    "goal": (np.int16, ("M", 2)),
    "family": (np.int16, ("M",)),
    "geodesic": (np.float32, ("M",)),
    "narrowest": (np.float32, ("M",)),
    "doors": (np.int16, ("M",)),
    "names": (np.uint8, ("F",)),
}
_ADVICE = "make the plans anew with pecjax maps make"


def write_plans(path: Path, plans: Plans) -> None:
    """Writes plans; the same plans are the same bytes.

    Raises:
        InputError: the file cannot be written, or plans have lengths that are no whole centimetres.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, (dtype, _) in _ARRAYS.items():
        if name == "names":
            arrays[name] = np.frombuffer("\n".join(plans.names).encode(), np.uint8)
            continue
        array = getattr(plans, name)
        if dtype == np.int16 and array.dtype == np.float32:
            array = to_centimetres(array, f"{path}: {name}")
        arrays[name] = array.astype(dtype)
    if not path.name:
        raise InputError(f"'{path}' is no name of a file; give one with --out")
    with writing(path, "put that right and make the plans again"):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_arrays(path, arrays)


def read_plans(path: Path) -> Plans:
    """Reads plans back; what a file from a stranger says of them is found out by `check_plans`.

    Raises:
        InputError: there is no such file, it holds no plans, or numbers that none have.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; make one with pecjax maps make")
    arrays = read_plain_arrays(path, _ADVICE)
    sizes: dict[str, int] = {}
    for name in sorted({*_ARRAYS} ^ {*arrays}):
        what = "is missing" if name in _ARRAYS else "is none of theirs"
        raise InputError(f"{path}: no plans, '{name[:60]}' {what}; {_ADVICE}")
    for name, (dtype, shape) in _ARRAYS.items():
        array = arrays[name]
        sides = zip(shape, array.shape, strict=False)
        wanted = tuple(sizes.setdefault(a, b) if isinstance(a, str) else a for a, b in sides)
        if array.dtype != dtype or array.ndim != len(shape) or wanted != array.shape:
            raise InputError(f"{path}: no plans, '{name}' is {array.shape} {array.dtype}; {_ADVICE}")
    if not (1 <= sizes["M"] <= MAX_PLANS and 1 <= sizes["W"] <= MAX_BOXES and sizes["F"] <= 2**16):
        raise InputError(
            f"{path}: {sizes['M']} plans of {sizes['W']} boxes; 1 to {MAX_PLANS:,} of 1 to {MAX_BOXES} can be"
        )
    _check_numbers(path, arrays)
    names = arrays.pop("names").tobytes().decode(errors="replace").split("\n")
    if len(names) > _MAX_NAMES or np.any((arrays["family"] < 0) | (arrays["family"] >= len(names))):
        raise InputError(f"{path}: a plan is of a family that has no name; {_ADVICE}")
    for name in ("lower", "upper", "bounds", "start", "goal"):
        arrays[name] = to_metres(arrays[name])
    for name in ("family", "doors"):
        arrays[name] = arrays[name].astype(np.int32)
    return Plans(**arrays, names=tuple(names))


def _check_numbers(path: Path, arrays: dict[str, np.ndarray]) -> None:
    lower, upper = (arrays[name].astype(np.int64) for name in ("lower", "upper"))
    filling = np.all((lower == NOWHERE) & (upper == NOWHERE), axis=-1)
    inside = (np.abs(lower) <= _MAX_CORNER) & (np.abs(upper) <= _MAX_CORNER) & (lower < upper)
    bounds = arrays["bounds"].astype(np.int64)
    measures = np.stack([arrays["geodesic"], arrays["narrowest"]], axis=-1)
    wrong = {
        "a box has no size or lies too far away": ~np.all(filling | inside.all(axis=-1), axis=1),
        "it has no box": filling.all(axis=1),
        "its bounds are none": np.any(
            (bounds[:, 0] >= bounds[:, 1])[:, None] | (np.abs(bounds) > _MAX_CORNER), axis=(1, 2)
        ),
        "start or goal lies outside its bounds": np.any(
            [(arrays[name] < bounds[:, 0]) | (arrays[name] > bounds[:, 1]) for name in ("start", "goal")],
            axis=(0, 2),
        ),
        "start and goal are one": np.all(arrays["start"] == arrays["goal"], axis=1),
        "a measure is no length": ~np.all((measures > 0) & (measures < 1e6), axis=1),
        "its number of doors is below 0": arrays["doors"] < 0,
    }
    for what, rows in wrong.items():
        if rows.any():
            raise InputError(f"{path}: plan {int(rows.argmax())}: {what}; {_ADVICE}")
