"""Plain files: rows and settings as text, put on disk whole or not at all, by one process at a time."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import cattrs
import filelock
import numpy as np

from pecjax import settings_tree
from pecjax.errors import InputError
from pecjax.runtime.distributed import is_primary

Row = dict[str, Any]
Settings = TypeVar("Settings")


def csv_text(rows: Iterable[Row], header: bool = True) -> str:
    """Rows with the same columns as lines of CSV, a header before them if there are any."""
    text = io.StringIO()
    for number, row in enumerate(rows):
        writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
        if header and number == 0:
            writer.writeheader()
        writer.writerow({key: _plain(value) for key, value in row.items()})
    return text.getvalue()


def markdown_text(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, its first row the head."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def joined_tables(texts: Iterable[str]) -> str:
    """One table of several, with the columns of all: a row of a table that lacks one has an empty field.

    The columns of the longest come first.
    """
    tables = [text.partition("\n") for text in texts]
    headers = sorted({head for head, _, _ in tables if head}, key=lambda head: (-len(head), head))
    if len(headers) < 2:
        return f"{''.join(headers)}\n{''.join(rows for _, _, rows in tables)}"
    columns = list(dict.fromkeys(name for head in headers for name in head.split(",")))
    joined = io.StringIO()
    writer = csv.DictWriter(joined, columns, restval="", lineterminator="\n")
    writer.writeheader()
    for head, _, rows in tables:
        writer.writerows(csv.DictReader(io.StringIO(rows), head.split(",")))
    return joined.getvalue()


def _plain(value: Any) -> Any:
    """Seven digits are all that float32 holds; a missing figure is an empty field."""
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value:.7g}"
    return value


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
    try:
        new.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(new, path)
    except OSError:
        new.unlink(missing_ok=True)  # on a full disk it would take the room that is wanted
        raise


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
