"""Plain files: settings as text, and files put on disk whole or not at all, by one process at a time."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import cattrs
import filelock

from pecjax import settings_tree
from pecjax.errors import InputError
from pecjax.runtime.distributed import is_primary

Settings = TypeVar("Settings")


def exact_text(value: float) -> str:
    """A setting with all its digits, for names and keys: the same text is the same number."""
    return repr(float(value)).removesuffix(".0")


def json_text(content: dict[str, Any]) -> str:
    """One JSON object, for people to read too."""
    return json.dumps(content, indent=2) + "\n"


def read_settings(path: Path, kind: type[Settings], what: str, today: Callable[[Any], Any]) -> Settings:
    """Reads the settings back that a file was written with.

    Args:
        what: a run or a study; what the folder lacks.
        today: makes of a former version's settings what is written today.

    Raises:
        InputError: the file is missing, or this version cannot read it.
    """
    if not path.is_file():
        raise InputError(f"{path.parent}: no {what} here ({path.name} is missing); give a {what}'s folder")
    try:
        return settings_tree.from_json(today(json.loads(path.read_text())["settings"]), kind)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (ValueError, KeyError, TypeError, cattrs.BaseValidationError) as error:
        raise InputError(
            f"{path}: cannot be read as a {what}'s settings ({error}); give another {what}"
        ) from error


def replace_file(path: Path, content: str | bytes) -> None:
    """Puts a whole file in place of another: whoever reads sees the old or the new one."""
    new = path.with_name(f".{path.name}.new")
    with replacing(path, new):
        new.write_bytes(content.encode() if isinstance(content, str) else content)


@contextlib.contextmanager
def replacing(path: Path, new: Path) -> Iterator[None]:
    """Where `new` is written; it then takes the place of `path` at once, or is removed if anything fails."""
    try:
        yield
        os.replace(new, path)
    finally:
        new.unlink(missing_ok=True)  # on a full disk it would take the room that is wanted


@contextlib.contextmanager
def writing(folder: Path, advice: str) -> Iterator[None]:
    """While it is entered, a disk that is full or read-only gets its line.

    Raises:
        InputError: something could not be written, and the advice.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); {advice}") from error


def check_free(folder: Path) -> None:
    """Makes sure that something new can be written into `folder`, without leaving anything there.

    Raises:
        InputError: the folder holds something already, or cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; give a folder with --out")
    if folder.is_dir() and any(path.name != _LOCK for path in folder.iterdir()):
        held = next((held for name, held in _HELD.items() if (folder / name).exists()), "is not empty")
        raise InputError(f"{folder}: {held}; give another folder with --out")
    nearest = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: {nearest} cannot be written; give another folder with --out")


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Keeps other trainings from writing a run or a study into the folder at the same time.

    Where several processes share a training, the primary process holds the lock for all.

    Raises:
        InputError: another one does already.
    """
    if not is_primary():
        yield
        return
    lock = filelock.FileLock(folder / _LOCK, timeout=0)
    with writing(folder, "make room, or see to its permissions"):
        try:
            lock.acquire()  # the system's own lock: gone with the process, however it ends
        except filelock.Timeout as error:
            raise InputError(f"{folder}: another process trains here; wait for its end") from error
    try:
        yield
    finally:
        lock.release()


_LOCK = ".lock"  # stays in the folder, where it means nothing unless a process holds it
_HELD = {"config.json": "holds another run", "study.json": "holds a study"}
