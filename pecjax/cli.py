"""The command line: `pecjax` and its commands."""

from __future__ import annotations

import dataclasses
import os
import signal
import sys
from collections.abc import Sequence
from typing import Annotated, get_args

import tyro

import pecjax
from pecjax.commands import settings_args
from pecjax.commands.check import Check
from pecjax.commands.evaluate import Eval
from pecjax.commands.export import Export
from pecjax.commands.figures import Figures
from pecjax.commands.maps import ACTIONS, Maps
from pecjax.commands.new_map import NewMap
from pecjax.commands.options import read
from pecjax.commands.spaces import Spaces
from pecjax.commands.study import Study
from pecjax.commands.train import Train
from pecjax.commands.watch import Watch
from pecjax.errors import DivergedError, InputError, LostProcessError, StoppedError, nearest
from pecjax.runtime import devices

_HELP = """\
usage: pecjax COMMAND [OPTIONS]

Trains drones to find their way through rooms, end to end on the accelerator.

  pecjax watch demo    shows a trained drone
  pecjax train         trains one

commands:
{commands}

pecjax COMMAND --help lists the options of a command, pecjax --version says which version this is."""

Command = (
    Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Eval, tyro.conf.subcommand("eval")]
    | Annotated[Watch, tyro.conf.subcommand("watch")]
    | Annotated[Study, tyro.conf.subcommand("study")]
    | Annotated[Figures, tyro.conf.subcommand("figures")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[NewMap, tyro.conf.subcommand("new-map")]
    | Annotated[Maps, tyro.conf.subcommand("maps")]
    | Annotated[Spaces, tyro.conf.subcommand("spaces")]
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
    if words[:1] in (["--help"], ["-h"]):
        summaries = {name: kind.__doc__.partition("\n")[0] for name, kind in commands.items()}
        print(_HELP.format(commands="\n".join(f"  {name:10}{line}" for name, line in summaries.items())))
        raise SystemExit(0)
    if not words:
        raise InputError(f"no command; give one of {', '.join(commands)}, or --help")
    command = words[0]
    if command not in commands:
        known = [*commands, "--help", "--version"]
        raise InputError(
            f"unknown command '{command}'{nearest(command, known)}; give one of {', '.join(known)}"
        )
    named = kind = commands[command]
    if kind is Maps and words[1:2] not in (["--help"], ["-h"]):
        named, command = _action(words), " ".join(words[:2])
    words, settings = settings_args.split(words, kind) if kind in (Train, Study) else (words, [])
    known = ["--" + field.name.replace("_", "-") for field in dataclasses.fields(named)]
    try:
        found = read(Command, words, known, prog="pecjax")
        options = found.action if isinstance(found, Maps) else found
        for field in dataclasses.fields(options):
            if field.default is None and getattr(options, field.name) == ():
                raise InputError(f"--{field.name.replace('_', '-')} has no value; give one or leave it out")
    except InputError as error:
        raise InputError(f"{error}; pecjax {command} --help lists all options") from None
    except SystemExit:
        if kind in (Train, Study):
            settings_args.print_help(settings_args.shown_by_help([*words, *settings]), kind)
        raise
    return dataclasses.replace(found, settings=tuple(settings)) if settings else found


def _action(words: Sequence[str]) -> type:
    """What `pecjax maps` is asked to do.

    Raises:
        InputError: nothing, or what it cannot do.
    """
    asked = " ".join(words[1:2])
    if asked not in ACTIONS:
        what = f"unknown action '{asked}'{nearest(asked, [*ACTIONS])}" if asked else "no action"
        raise InputError(f"{what}; give one of {', '.join(ACTIONS)}; pecjax {words[0]} --help explains them")
    return ACTIONS[asked]


def main(args: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    devices.use_all_cores()
    devices.keep_compiled_programs()
    if "" not in sys.path:
        sys.path.append("")  # samplers of one's own may lie in the folder that the command is run in
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
    except BrokenPipeError:  # whoever read the output has had enough of it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except KeyboardInterrupt:
        print("pecjax: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
