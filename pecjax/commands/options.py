"""Options: how they are read and shown, and how a wrong one is answered in one line."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import itertools
import re
from collections.abc import Sequence
from typing import Annotated, Any, TypeVar

import tyro

from pecjax import settings_tree
from pecjax.errors import InputError, nearest

T = TypeVar("T")

# Its description says what happens without it, where tyro would say "(default: None)"; and `None` is
# nothing that can be typed.
Option = Annotated[T | None, tyro.conf.DisallowNone, tyro.conf.arg(help_behavior_hint="")]
Strings = Annotated[Option[tuple[str, ...]], tyro.conf.arg(metavar="STR [STR ...]")]
Floats = Annotated[Option[tuple[float, ...]], tyro.conf.arg(metavar="FLOAT [FLOAT ...]")]
# Words that another reader takes: no option, and not shown.
Rest = Annotated[tuple[str, ...], tyro.conf.Fixed, tyro.conf.Suppress]
_TAKES = {"INT": "a whole number", "int()": "a whole number", "FLOAT": "a number", "{[FLOAT": "numbers"}


def read(kind: Any, words: Sequence[str], known: Sequence[str] = (), **options: Any) -> Any:
    """What tyro reads from the words.

    Args:
        known: options that may have been meant; by default those of the tree in `default`.
        options: of `tyro.cli`.

    Raises:
        InputError: they cannot be understood.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(kind, args=list(words), **options)
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        if not known and dataclasses.is_dataclass(options.get("default")):
            paths = dict(settings_tree.leaves(options["default"]))
            known = ["--" + path.replace("_", "-") for path in paths]
        raise InputError(_one_line(complaint.getvalue(), [*known])) from None


def _one_line(complaint: str, known: list[str]) -> str:
    """The gist of tyro's complaint, which fills a box of several sections."""
    lines = [line.strip(" │|") for line in complaint.splitlines()]
    # Below the title, as far as the next line that is empty or drawn; the rest is help text.
    words = re.compile(r"\w").search
    below = itertools.dropwhile(lambda line: not words(line), lines[1:])
    line = " ".join(itertools.takewhile(words, below)) or " ".join(lines)
    if found := re.fullmatch(r"Unrecognized or misplaced options: (--\S+).*", line):
        return f"unknown option {found[1]}{nearest(found[1], known)}"
    if found := re.fullmatch(r"Unrecognized options: (.*)", line):
        given = found[1].split(", ")
        unknown = next((word for word in given if word.startswith("-")), None)
        if unknown:
            return f"unknown option {unknown}{nearest(unknown, known)}"
        return f"unexpected '{given[0]}'"
    if found := re.fullmatch(r"Error parsing (\S+): no type matching (\S+) .* from \[(.*)\]\.", line):
        return f"{found[1]} takes {_TAKES.get(found[2], found[2])}, not {found[3]}"
    if found := re.fullmatch(r"Error parsing (\S+): invalid literal for (\S+) .*?('.*')", line):
        return f"{found[1]} takes {_TAKES.get(found[2], found[2])}, not {found[3]}"
    if found := re.fullmatch(r"Error parsing (\S+): could not convert string to float: ('.*')", line):
        return f"{found[1]} takes a number, not {found[2]}"
    return line.removesuffix(".")
