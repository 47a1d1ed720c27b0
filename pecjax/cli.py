"""The command line: `pecjax train`, `eval`, `study`, `figures` and `check`."""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from typing import Annotated

import tyro

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
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(Command, prog="pecjax", description=__doc__, args=args)
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        # tyro frames its complaint in a box of several lines; ours is one.
        words = re.sub(r"[^\x20-\x7e]+", " ", complaint.getvalue())
        raise InputError(" ".join(words.split())) from None


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
