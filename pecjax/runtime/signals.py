"""Interruption: Ctrl-C and SIGTERM, handled between two iterations."""

from __future__ import annotations

import signal
import threading
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """While it is entered, the first signal is only noted in `asked`; the second acts as ever."""

    def __init__(self) -> None:
        """Nothing has been asked yet."""
        self.asked: signal.Signals | None = None
        self._before: dict[signal.Signals, signal._HANDLER] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():  # elsewhere Python forbids it
            self._before = {each: signal.signal(each, self._note) for each in SIGNALS}
        return self

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.asked = signal.Signals(number)
        self._restore()

    def _restore(self) -> None:
        for each, handler in self._before.items():
            signal.signal(each, handler)
        self._before = {}

    def __exit__(self, *_: object) -> None:
        self._restore()
