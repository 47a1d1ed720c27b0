"""Trees of settings: frozen dataclasses whose leaves have dotted paths and whose kinds have addresses.

A kind is a subclass that a field of its base class may hold: of `SamplerSettings`, say. Its address,
`module:Class`, is kept with its settings, so that any process can read them again.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import importlib.metadata
import inspect
import pkgutil
from collections.abc import Iterator, Mapping
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import cattrs
from cattrs.gen import make_dict_structure_fn

from pecjax.errors import InputError, nearest

T = TypeVar("T")
KIND = "kind"  # the key of a kind's address in JSON
MAX_SHOWN = 100  # characters of a value in a message


def address(kind: type) -> str:
    """Where a kind is found again: `module:Class`."""
    return f"{kind.__module__}:{kind.__qualname__}"


def resolve(name: str, base: type[T], package: str) -> type[T]:
    """The kind of that name.

    Args:
        name: of a module or package within `package` that defines one kind, of an entry point in the
            group that is called as the package is, or an address.
        base: what it is a kind of.

    Raises:
        InputError: there is none, it cannot be imported, or it is of another kind.
    """
    if ":" in name:
        return _load(name, base)
    modules = [about.name for about in pkgutil.iter_modules(importlib.import_module(package).__path__)]
    if name in modules and (kind := _only_kind(f"{package}.{name}", base)):
        return kind
    entries = {entry.name: entry.value for entry in importlib.metadata.entry_points(group=package)}
    if name in entries:
        return _load(entries[name], base)
    known = [module for module in modules if _only_kind(f"{package}.{module}", base)] + [*entries]
    what = base.__name__.removesuffix("Settings").lower()
    raise InputError(
        f"unknown {what} '{name}'{nearest(name, known)}; choose one of {', '.join(known)}, "
        "or give one of your own as my.module:Class"
    )


def short_name(kind: type, package: str) -> str:
    """The name that `resolve` knows a kind by: short for those of the package, else the address."""
    if not kind.__module__.startswith(f"{package}."):
        return address(kind)
    name = kind.__module__.removeprefix(f"{package}.").partition(".")[0]
    base = next(base for base in kind.__mro__ if inspect.isabstract(base))
    return name if _only_kind(f"{package}.{name}", base) is kind else address(kind)


def leaves(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every leaf's dotted path and value."""
    for field in dataclasses.fields(tree):
        value, place = getattr(tree, field.name), f"{path}.{field.name}".lstrip(".")
        if dataclasses.is_dataclass(value):
            yield from leaves(value, place)
        else:
            yield place, value


def set_path(tree: T, path: str, value: Any) -> T:
    """The tree with another value at a dotted path.

    Raises:
        InputError: there is no such path, or the value is of another type.
    """
    return _set(tree, path.split("."), path, value)


def _set(tree: Any, names: list[str], path: str, value: Any) -> Any:
    first, *rest = names
    is_tree = dataclasses.is_dataclass(tree)
    fields = [field.name for field in dataclasses.fields(tree)] if is_tree else []
    if first not in fields:
        known = f"there are {', '.join(fields)}" if fields else "it has no settings"
        raise InputError(f"no setting {path}{nearest(first, fields)}; of {type(tree).__name__} {known}")
    if rest:
        new = _set(getattr(tree, first), rest, path, value)
    else:
        declared = get_type_hints(type(tree))[first]
        try:
            if isinstance(value, str) and _takes_several(declared):
                raise TypeError("text is no sequence of values")
            # As a list's item: alone, a Literal would raise what is no BaseValidationError.
            (new,) = _converter().structure([value], list[declared])
        except (ValueError, TypeError, cattrs.BaseValidationError) as error:
            raise InputError(f"{path} is {value!r}; it takes {_in_words(declared)}") from error
    return dataclasses.replace(tree, **{first: new})


def _in_words(declared: Any) -> str:
    """A type as a user may read it."""
    if get_origin(declared) is Literal or type(None) in get_args(declared):
        return " or ".join(map(_in_words, get_args(declared)))
    return "none" if declared is type(None) else getattr(declared, "__name__", str(declared))


def _takes_several(declared: Any) -> bool:
    return any(get_origin(part) is tuple for part in (declared, *get_args(declared)))


def replace_at(tree: T, path: str, value: Any) -> T:
    """The tree with a value, of the right type, in the place of what a dotted path leads to."""
    first, _, rest = path.partition(".")
    inner = replace_at(getattr(tree, first), rest, value) if rest else value
    changed: Any = tree  # a dataclass, which a type variable cannot be bound to
    return dataclasses.replace(changed, **{first: inner})


def to_json(tree: Any, declared: Any = None) -> Any:
    """A tree as what JSON holds: every setting, and the address of every kind.

    Args:
        declared: the type of the field that holds it, where there is one.
    """
    if dataclasses.is_dataclass(tree):
        hints = get_type_hints(type(tree))
        content = {
            field.name: to_json(getattr(tree, field.name), hints[field.name])
            for field in dataclasses.fields(tree)
        }
        return content if declared in (None, type(tree)) else {KIND: address(type(tree))} | content
    return [to_json(value) for value in tree] if isinstance(tree, tuple | list) else tree


def from_json(content: Any, kind: type[T]) -> T:
    """Reads back what `to_json` made of a tree.

    Raises:
        InputError: a kind that cannot be had, or that does not take one of the settings given.
        ValueError, KeyError, TypeError, cattrs.BaseValidationError: it is no such tree.
    """
    try:
        return _converter().structure(content, kind)
    except cattrs.BaseValidationError as error:
        for part in _parts(error):
            if isinstance(part, InputError):
                raise part from error
        raise


def differences(before: Any, now: Any, name: str = "") -> Iterator[str]:
    """Where two JSON values differ, in words."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in {**before, **now}:
            yield from differences(before.get(key), now.get(key), f"{name}.{key}".lstrip("."))
    elif before != now:
        yield f"{name} ({_in_short(before)} there, {_in_short(now)} here)"


def _in_short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"


def _only_kind(module: str, base: type[T]) -> type[T] | None:
    """The kind that a module defines, if just one; none of a module whose library is not installed."""
    try:
        content = vars(importlib.import_module(module))
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] == module.partition(".")[0]:
            raise
        return None
    kinds = [
        value
        for value in content.values()
        if isinstance(value, type) and issubclass(value, base)
        if value.__module__ == module or value.__module__.startswith(f"{module}.")
        if not inspect.isabstract(value)
    ]
    return kinds[0] if len(kinds) == 1 else None


def _load(where: str, base: type[T]) -> type[T]:
    module, _, name = where.partition(":")
    try:
        found = functools.reduce(getattr, name.split("."), importlib.import_module(module))
    except Exception as error:  # somebody else's module may fail in any way
        raise InputError(f"{where}: cannot be imported ({type(error).__name__}: {error})") from error
    if not (isinstance(found, type) and issubclass(found, base) and dataclasses.is_dataclass(found)):
        raise InputError(f"{where}: is no {base.__name__}; make it a frozen dataclass that extends it")
    if inspect.isabstract(found):
        missing = ", ".join(sorted(found.__abstractmethods__))
        raise InputError(f"{where}: lacks {missing}; define it")
    return found


@functools.cache
def _converter() -> cattrs.Converter:
    converter = cattrs.Converter()
    plain = functools.cache(lambda kind: make_dict_structure_fn(kind, converter))

    def structure(content: Any, declared: type) -> Any:
        if isinstance(content, declared):
            return content
        if not isinstance(content, Mapping):
            raise TypeError(f"{content!r} is no {declared.__name__}")
        kind, given = declared, dict(content)
        if KIND in given:
            kind = _load(str(given.pop(KIND)), declared)
        fields = [field.name for field in dataclasses.fields(kind)]
        for name in given:
            if name not in fields:
                raise InputError(f"{address(kind)}: has no setting {name}{nearest(name, fields)}")
        return plain(kind)(given, kind)

    converter.register_structure_hook(int, lambda value, _: _whole(value))
    converter.register_structure_hook(bool, lambda value, _: _truth(value))
    converter.register_structure_hook_func(
        lambda kind: isinstance(kind, type) and dataclasses.is_dataclass(kind), structure
    )
    return converter


def _whole(value: Any) -> int:
    if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
        raise ValueError(f"{value!r} is no whole number")
    return int(value)


def _truth(value: Any) -> bool:
    known = {True: True, False: False, "true": True, "false": False}
    if isinstance(value, bool | str) and value in known:
        return known[value]
    raise ValueError(f"{value!r} is neither true nor false")


def _parts(error: BaseException) -> Iterator[BaseException]:
    """All that an error was raised from, or is a group of."""
    yield error
    for part in (*getattr(error, "exceptions", ()), *filter(None, [error.__cause__])):
        yield from _parts(part)
