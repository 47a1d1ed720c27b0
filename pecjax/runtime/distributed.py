"""Processes: those that share one training, what they agree on, and how they end together.

Each of them runs the same program on devices of its own. Only the first, the primary process, writes files
and prints.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from pecjax.errors import InputError, LostProcessError

JOIN_SECONDS = 120  # that the first to come waits for the last
HEARTBEAT_SECONDS = 30  # without a sign of life, and a process counts as dead
LOST = "another process of this training has died or cannot be reached"

# The kinds of failure that an unanswered call can be; others, such as too little memory, are our own.
_UNREACHED = ("ABORTED", "CANCELLED", "DEADLINE_EXCEEDED", "INTERNAL", "UNAVAILABLE", "UNKNOWN")
# JAX ends a process whose peers are gone from C++, where Python has no say: this stays to say it.
_GUARD = "import sys; sys.stdin.read(1) or sys.stderr.write(sys.argv[1])"


def join(coordinator: str, number: int | None = None, index: int | None = None) -> None:
    """Makes this process one of those that share a training; call it before JAX is first used.

    Args:
        coordinator: HOST:PORT of the primary process, which the others can reach, or `auto` where SLURM or
            Open MPI started the processes and can be asked.
        number, index: how many there are, and which this is; the primary process is 0.

    Raises:
        InputError: these do not go together, or not all processes came in `JOIN_SECONDS`.
    """
    if coordinator == "auto":
        where = {}
    else:
        if not re.fullmatch(r"[^\s:]+:\d{1,5}|\[[0-9a-fA-F:]+\]:\d{1,5}", coordinator):
            raise InputError(
                f"coordinator is '{coordinator}'; give HOST:PORT, or auto under SLURM or Open MPI"
            )
        if number is None or index is None or not 0 <= index < number:
            raise InputError(
                f"num-processes is {number} and process-id is {index}; "
                "give both, the second from 0 to one below the first"
            )
        where = {"coordinator_address": coordinator, "num_processes": number, "process_id": index}
    # JAX would catch SIGTERM for its own kind of stop; `Interruption` is ours.
    jax.config.update("jax_enable_preemption_service", False)
    late = f"coordinator {coordinator}: not all processes came within {JOIN_SECONDS} s"
    try:
        with _guarded(f"{late}; start them all, with an address that they can reach"):
            jax.distributed.initialize(
                **where,
                initialization_timeout=JOIN_SECONDS,
                heartbeat_timeout_seconds=HEARTBEAT_SECONDS,
                shutdown_timeout_seconds=HEARTBEAT_SECONDS,
            )
    except (RuntimeError, ValueError) as error:
        raise InputError(f"coordinator {coordinator}: the processes could not be joined ({error})") from error


def is_primary() -> bool:
    """Whether this process writes files and prints; a process that is alone does."""
    return jax.process_index() == 0


def primary_only(write: Callable[..., None]) -> Callable[..., None]:
    """Makes only the primary process run a function: all processes share one folder."""

    @functools.wraps(write)
    def write_if_primary(*args: Any, **kwargs: Any) -> None:
        if is_primary():
            write(*args, **kwargs)

    return write_if_primary


@contextlib.contextmanager
def synchronized(what: Any = None) -> Iterator[None]:
    """What every process does for itself before it needs the others: if one fails, none continues.

    Args:
        what: has to be the same in all of them, by its `repr`.

    Raises:
        InputError: of its own; or another process failed, or was started with something else.
    """
    digest = np.frombuffer(hashlib.sha256(repr(what).encode()).digest(), np.uint8)
    try:
        yield
    except InputError:
        _tell(digest, well=False)
        raise
    told = _tell(digest, well=True)
    if not told[:, 0].all():
        raise InputError("another process could not start; its own output tells why")
    if (told[:, 1:] != digest).any():
        raise InputError("the processes were started with settings that differ; give them all the same")


def _tell(digest: np.ndarray, well: bool) -> np.ndarray:
    mine = np.concatenate([np.array([well], np.uint8), digest])
    return mine[None] if jax.process_count() == 1 else multihost_utils.process_allgather(mine)


def greatest(number: int) -> int:
    """The greatest of the numbers that the processes give."""
    if jax.process_count() == 1:
        return number
    return int(multihost_utils.process_allgather(np.int32(number)).max())


def on_host(array: Any) -> np.ndarray:
    """The whole of an array, wherever its parts are; all processes call it."""
    if isinstance(array, jax.Array) and not array.is_fully_addressable:
        return multihost_utils.process_allgather(array, tiled=True)
    return np.asarray(array)


@contextlib.contextmanager
def ending_together(advice: str) -> Iterator[None]:
    """Says in one line, with some advice, that this process ends since another has died.

    Raises:
        LostProcessError: the other one was missed by this one's own computation.
    """
    if jax.process_count() == 1:
        yield
        return
    try:
        with _guarded(f"killed, most likely because {LOST}; {advice}"):
            yield
    except jax.errors.JaxRuntimeError as error:
        if not str(error).startswith(_UNREACHED):
            raise
        raise LostProcessError(f"{LOST} ({str(error).splitlines()[0][:200]}); {advice}") from error


@contextlib.contextmanager
def _guarded(line: str) -> Iterator[None]:
    """Has a second process print the line if this process is killed meanwhile."""
    command = [sys.executable, "-c", _GUARD, f"pecjax: {line}\n"]
    guard = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
    try:
        yield
    finally:
        guard.communicate(b".")
