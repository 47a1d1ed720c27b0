"""Axes of configurations: one declaration says how an axis is stored, read, written and bounded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from pecjax.errors import InputError, nearest

Table = TypeVar("Table")
_KEY = "axis"


class Axis(NamedTuple):
    """What one field of a table of configurations holds.

    Attributes:
        columns: names in a file, one a number.
        dtype: of the array.
        default: of every number where a file does not say; None where it must.
        unit: of all its columns, for people.
        low, high: the bounds of every number.
        optional: whether a table may do without the axis, which is None there.
    """

    columns: tuple[str, ...]
    dtype: type[np.generic]
    default: float | None
    unit: str
    low: float
    high: float
    optional: bool


def axis(
    columns: str,
    *,
    dtype: type[np.generic] = np.float32,
    default: float | None = None,
    unit: str = "",
    low: float = -np.inf,
    high: float = np.inf,
    optional: bool = False,
) -> Any:
    """Declares a field of a table: an array (N,) of one column, (N, k) of k columns.

    A field with a default may be left out; `fill` puts the default there. An optional one that is left
    out stays None: its table is another pytree, and programs for it have nothing of the axis.

    Raises:
        ValueError: an optional axis without a default, the number that has the least effect.

    Example:
        @struct.dataclass
        class Configurations:
            start: jax.Array = axis("start_x start_y", unit="m")
            wind: jax.Array = axis("wind", default=0.0, unit="m/s", low=-20, high=20)
    """
    if optional and default is None:
        raise ValueError(f"the optional axis '{columns}' needs a default")
    about = Axis(tuple(columns.split()), dtype, default, unit, low, high, optional)
    # None is no leaf of a pytree: an axis that was not given is filled in where its length is known.
    return dataclasses.field(metadata={_KEY: about}, default=dataclasses.MISSING if default is None else None)


def axes_of(kind: type) -> dict[str, Axis]:
    """The axes of a table's class by the names of its fields."""
    return {field.name: field.metadata[_KEY] for field in dataclasses.fields(kind)}


def columns_of(kind: type) -> dict[str, Axis]:
    """The axes of a table's class by the names of their columns, in order."""
    return {column: about for about in axes_of(kind).values() for column in about.columns}


def make_table(kind: type[Table], **values: Any) -> Table:
    """A table of the class, from arrays for some of its axes; the others have their defaults or are None.

    Args:
        values: (N,) or (N, k) each.

    Raises:
        InputError: no such axis, one missing that has no default, another shape, or a number out of
            its bounds.
    """
    axes = axes_of(kind)
    columns: dict[str, np.ndarray] = {}
    for name, value in values.items():
        if name not in axes:
            raise InputError(f"no axis {name}{nearest(name, [*axes])}; there are {', '.join(axes)}")
        numbers, wanted = np.asarray(value), axes[name].columns
        shape = "(N,)" if len(wanted) == 1 else f"(N, {len(wanted)})"
        if numbers.shape[1:] != (() if len(wanted) == 1 else (len(wanted),)) or not numbers.ndim:
            raise InputError(f"{name} has shape {numbers.shape}; give an array {shape}")
        columns |= dict(zip(wanted, numbers.reshape(len(numbers), -1).T, strict=True))
    return from_columns(kind, columns)


def from_columns(
    kind: type[Table],
    columns: Mapping[str, Any],
    place: Callable[[int, str], str] = lambda row, column: f"configuration {row}",
) -> Table:
    """A table of the class from its columns, (N,) each; a missing axis has its default or is None.

    Args:
        place: what messages call a number, by row and column.

    Raises:
        InputError: an unknown column, a missing one, columns of several lengths, or a number that
            is out of its bounds or no whole one where it must be.
    """
    known = columns_of(kind)
    for name in columns:
        if name not in known:
            raise InputError(f"'{name}' is unknown{nearest(name, [*known])}; {_describe(known)}")
    lengths = {len(values) for values in columns.values()}
    if len(lengths) != 1:
        raise InputError(f"the columns have {sorted(lengths)} rows; give as many of each")
    (number,) = lengths
    for name, values in columns.items():
        _check(name, known[name], np.asarray(values, np.float64), place)
    leaves = {}
    for field, about in axes_of(kind).items():
        missing = [name for name in about.columns if name not in columns]
        if missing and (about.default is None or len(missing) < len(about.columns)):
            raise InputError(f"no column {missing[0]}; {_describe(known)}")
        if missing and about.optional:
            continue
        parts = [np.full(number, about.default) if missing else columns[name] for name in about.columns]
        stacked = np.stack([np.asarray(part) for part in parts], axis=-1).astype(about.dtype)
        leaves[field] = stacked if len(about.columns) > 1 else stacked[:, 0]
    return kind(**leaves)


def fill(table: Table) -> Table:
    """The table, or a row of one, with the defaults of the axes that were left out and are not optional."""
    axes: dict[str, Axis] = axes_of(type(table))
    given = {name: value for name in axes if (value := getattr(table, name)) is not None}
    first = next(iter(given))
    leading = np.shape(given[first])[: np.ndim(given[first]) - (len(axes[first].columns) > 1)]
    missing = {
        name: np.full(leading + (len(about.columns),) * (len(about.columns) > 1), about.default, about.dtype)
        for name, about in axes.items()
        if name not in given and not about.optional
    }
    return type(table)(**given, **missing)


def to_columns(table: Any) -> dict[str, np.ndarray]:
    """The columns of a table, (N,) each, without the axes that were left out."""
    columns = {}
    for field, about in axes_of(type(table)).items():
        if getattr(table, field) is None:
            continue
        numbers = np.asarray(getattr(table, field))
        columns |= dict(zip(about.columns, numbers.reshape(len(numbers), -1).T, strict=True))
    return columns


def required(kind: type) -> list[str]:
    """The columns without which there is no table."""
    return [name for name, about in columns_of(kind).items() if about.default is None]


def _check(name: str, about: Axis, values: np.ndarray, place: Callable[[int, str], str]) -> None:
    whole = np.issubdtype(about.dtype, np.integer)
    wrong = ~((values >= about.low) & (values <= about.high) & np.isfinite(values))
    wrong |= whole & (values != np.round(values))
    if wrong.any():
        row = int(wrong.argmax())
        kind = "a whole number" if whole else "a number"
        bounds = [f"from {about.low:g}"] * (about.low > -np.inf) + [f"to {about.high:g}"] * (
            about.high < np.inf
        )
        unit = f" {about.unit}" if about.unit else ""
        raise InputError(
            f"{place(row, name)}: {name} is {values[row]:g}; it must be {' '.join([kind, *bounds])}{unit}"
        )


def _describe(known: Mapping[str, Axis]) -> str:
    return f"the columns are {', '.join(known)}"
