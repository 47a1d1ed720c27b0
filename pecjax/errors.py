"""Errors with causes outside pecjax: bad input, a stop, a lost process, divergence; a hint for messages."""

import difflib
import signal
from collections.abc import Iterable

MAX_LENGTH = 1000


class InputError(ValueError):
    """Something the user gave is wrong: a file, a number, a name.

    The message is one line that says what is wrong, where, and what to do. The command line
    prints it unchanged and exits with code 2. Every other exception is a bug in pecjax.
    """

    def __init__(self, message: str) -> None:
        """Keeps the message to one line of bounded length, whatever a library put into it."""
        line = " ".join(message.split())
        super().__init__(line if len(line) <= MAX_LENGTH else line[: MAX_LENGTH - 1] + "…")


class StoppedError(KeyboardInterrupt):
    """A training was asked to stop, and has saved all that it needs to resume.

    Attributes:
        signal: the signal that asked for it: SIGINT (Ctrl-C) or SIGTERM.
    """

    def __init__(self, message: str, signal: signal.Signals) -> None:
        """The message is one line that says how to resume."""
        super().__init__(message)
        self.signal = signal


class LostProcessError(RuntimeError):
    """One of the processes that share a training is gone; the message says how to resume."""


class DivergedError(ArithmeticError):
    """A loss, the parameters or the physics are no longer finite; the message says which and when."""


def nearest(word: str, known: Iterable[str]) -> str:
    """A hint at the word that was meant, if any is near."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""
