"""The command line: `pecjax train`, `eval`, `study`, `figures` and `check`; `pecjax --version`."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import io
import itertools
import re
import sys
from collections.abc import Sequence
from typing import Annotated, get_args

import tyro

import pecjax
from pecjax.commands.check import Check
from pecjax.commands.evaluate import Eval
from pecjax.commands.figures import Figures
from pecjax.commands.study import Study
from pecjax.commands.train import Train
from pecjax.errors import DivergedError, InputError, LostProcessError, StoppedError
from pecjax.experiments import devices

Command = (
    Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Eval, tyro.conf.subcommand("eval")]
    | Annotated[Study, tyro.conf.subcommand("study")]
    | Annotated[Figures, tyro.conf.subcommand("figures")]
    | Annotated[Check, tyro.conf.subcommand("check")]
)


def parse(args: Sequence[str] | None = None) -> Command:
    """Reads the command line.

    Raises:
        InputError: it cannot be understood.
    """
    words = list(sys.argv[1:] if args is None else args)
    commands = {about.name: kind for kind, about in map(get_args, get_args(Command))}
    if words == ["--version"]:
        print(f"pecjax {pecjax.__version__}")
        raise SystemExit(0)
    if not words:
        raise InputError(f"no command; give one of {', '.join(commands)}, or --help")
    command = words[0]
    if command not in (*commands, "--help", "-h"):
        known = [*commands, "--help", "--version"]
        raise InputError(
            f"unknown command '{command}'{_nearest(command, known)}; give one of {', '.join(known)}"
        )
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(Command, prog="pecjax", description=__doc__, args=words)
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        options = ["--" + field.name.replace("_", "-") for field in dataclasses.fields(commands[command])]
        line = _one_line(complaint.getvalue(), options)
        raise InputError(f"{line}; pecjax {command} --help lists all options") from None


def _one_line(complaint: str, options: list[str]) -> str:
    """The gist of tyro's complaint, which fills a box of several sections."""
    lines = [line.strip(" │|") for line in complaint.splitlines()]
    # Below the title, as far as the next line that is empty or drawn; the rest is help text.
    words = re.compile(r"\w").search
    below = itertools.dropwhile(lambda line: not words(line), lines[1:])
    line = " ".join(itertools.takewhile(words, below)) or " ".join(lines)
    if found := re.fullmatch(r"Unrecognized options: (.*)", line):
        given = found[1].split(", ")
        unknown = next((word for word in given if word.startswith("-")), None)
        return (
            f"unknown option {unknown}{_nearest(unknown, options)}" if unknown else f"unexpected '{given[0]}'"
        )
    if found := re.fullmatch(r"Error parsing (\S+): no type matching (\S+) .* from \[(.*)\]\.", line):
        kind = {"INT": "a whole number", "FLOAT": "a number", "{[FLOAT": "numbers"}.get(found[2], found[2])
        return f"{found[1]} takes {kind}, not {found[3]}"
    return line.removesuffix(".")


def _nearest(word: str, known: list[str]) -> str:
    near = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def main(args: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    devices.use_all_cores()
    devices.keep_compiled_programs()
    try:
        parse(args).run()
    except InputError as error:
        print(f"pecjax: {error}", file=sys.stderr)
        return 2
    except (DivergedError, LostProcessError) as error:
        print(f"pecjax: {error}", file=sys.stderr)
        return 1
    except StoppedError as stop:
        print(f"pecjax: {stop}", file=sys.stderr)
        return 128 + stop.signal
    except KeyboardInterrupt:
        print("pecjax: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
