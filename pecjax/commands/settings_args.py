"""Settings on the command line: every leaf of a run's tree by its dotted path."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import io
import itertools
import re
import sys
from collections.abc import Sequence
from typing import Any, get_type_hints

from pecjax import settings_tree
from pecjax.commands.options import read
from pecjax.errors import InputError
from pecjax.training.kinds import KINDS, make_kind
from pecjax.training.presets import find_preset
from pecjax.training.settings import RunSettings, override

# What has an option of its own in every command, or follows from one.
_ELSEWHERE = {"preset", "seed"}


def split(words: Sequence[str], command: type) -> tuple[list[str], list[str]]:
    """The words of a command line that are the command's own, and those that are settings.

    An option is a setting where its name has a dot, or is a leaf of the tree and no option of the
    command; the words up to the next option are its values.
    """
    own = {field.name for field in dataclasses.fields(command)}
    leaves = {path for path, _ in settings_tree.leaves(RunSettings())} - _ELSEWHERE - own
    kept: list[str] = []
    settings: list[str] = []
    into = kept
    for word in words:
        if word.startswith("--"):
            name = word.removeprefix("--").partition("=")[0].replace("-", "_")
            into = settings if "." in name or {name, name.removeprefix("no_")} & leaves else kept
        into.append(word)
    return kept, settings


def apply(settings: RunSettings, words: Sequence[str], command: type) -> RunSettings:
    """The settings with what the words of `split` change.

    Raises:
        InputError: no such setting, or a value that it does not take.
    """
    settings, words = _choose_kinds(settings, words)
    if not words:
        return settings
    tree = _tree(settings, command)
    words = ["None" if word == "none" else word for word in words]
    found = read(type(tree), words, default=tree)
    return dataclasses.replace(settings, **vars(found))


def _choose_kinds(settings: RunSettings, words: Sequence[str]) -> tuple[RunSettings, list[str]]:
    """Puts a kind at every path that has one, such as `--sampler.sampler uniform`; other options stay.

    Raises:
        InputError: no name follows, or there is no kind of it.
    """
    rest, left = [], iter(words)
    for word in left:
        option, equals, value = word.partition("=")
        path = option.removeprefix("--").replace("-", "_")
        slot = _slot_at(settings, path) if option.startswith("--") and "." in path else None
        if slot is None:
            rest.append(word)
            continue
        name = value if equals else next(left, "--")
        if name.startswith("--"):
            raise InputError(f"{option} has no value; give the name of a {slot}")
        *outer, last = path.split(".")
        holder = functools.reduce(getattr, outer, settings)
        chosen = make_kind(slot, name, getattr(holder, last))
        settings = settings_tree.replace_at(settings, path, chosen)
    return settings, rest


def _slot_at(settings: RunSettings, path: str) -> str | None:
    """The slot (see `kinds.KINDS`) of what a path leads to, if it leads to a kind."""
    value: Any = settings
    for name in path.split("."):
        value = getattr(value, name, None) if dataclasses.is_dataclass(value) else None
    return next((slot for slot, (base, _) in KINDS.items() if isinstance(value, base)), None)


def shown_by_help(words: Sequence[str]) -> RunSettings:
    """The settings that help is asked for: with the preset and the kinds that the words name."""
    parts = [part for word in words for part in word.split("=", 1)]
    given = {name.removeprefix("--"): value for name, value in itertools.pairwise(parts)}
    try:
        base = find_preset(given.get("preset"), given.get("agent"))
        base = override(base, task=given.get("task"), sampler=given.get("sampler"), agent=given.get("agent"))
        return _choose_kinds(base, [word for word in words if word not in ("--help", "-h")])[0]
    except InputError:
        return find_preset()


def print_help(settings: RunSettings, command: type) -> None:
    """Prints every setting with its meaning, its values and its default."""
    tree = _tree(settings, command)
    about = f"All other settings by their dotted paths; the defaults are those of preset {settings.preset}."
    # Boxes are drawn as the encoding allows.
    text = io.TextIOWrapper(io.BytesIO(), encoding=sys.stdout.encoding, write_through=True)
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(text):
        read(type(tree), ["--help"], default=tree, prog="[settings]", description=about)
    text.seek(0)
    shown = text.read().partition("\n\n")[2]  # without the usage, which the command has shown
    shown = re.sub(r"\{None\}\|(\{[^}]*\}|\S+)", r"\1|none  ", shown)  # as wide as before
    print("\n" + shown.replace("(default: None)", "(default: none)"), end="")


def _tree(settings: RunSettings, command: type) -> Any:
    """What may be set: the tree without what has an option of its own in every command."""
    of_command = {field.name for field in dataclasses.fields(command)}
    elsewhere = _ELSEWHERE | ({"sampler"} if "samplers" in of_command else set())  # a study has its own
    hints = get_type_hints(RunSettings)
    fields = [
        (field.name, hints[field.name], dataclasses.field(default=getattr(settings, field.name)))
        for field in dataclasses.fields(RunSettings)
        if field.name not in elsewhere
    ]
    kind = dataclasses.make_dataclass(
        "Settings", fields, frozen=True, namespace={"__doc__": RunSettings.__doc__}
    )
    return kind()
