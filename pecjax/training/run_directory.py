"""Run directories: the files that a run leaves behind, and how to read them again."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pecjax import settings_tree
from pecjax.envs.task import TaskSettings
from pecjax.errors import InputError
from pecjax.runtime.distributed import primary_only
from pecjax.runtime.provenance import FACTS, session_facts
from pecjax.storage import files
from pecjax.storage.arrays import by_iteration, iterations_in, read_plain_arrays, write_arrays
from pecjax.storage.tables import Row, csv_text
from pecjax.training import former_versions
from pecjax.training.settings import RunSettings


class RunDirectory:
    """One run's folder. Tables grow row by row and are on disk after each.

    Where several processes share a training, the first writes and all read.
    """

    def __init__(self, folder: Path) -> None:
        """Names the folder; nothing is read or written yet."""
        self.folder = folder

    @primary_only
    def create(self, settings: RunSettings, num_devices: int) -> None:
        """Writes what the run depends on: settings, and the files that its task reads.

        Raises:
            InputError: another run or study has started in the folder, or it cannot be written.
        """
        kept = settings.task.files()
        with files.writing(self.folder, "choose another --out"):
            self.folder.mkdir(parents=True, exist_ok=True)
            with files.alone(self.folder):  # whoever else begins here at this moment is refused
                files.check_free(self.folder)
                (self.folder / "figures").mkdir()
                for name, content in kept.items():
                    (self.folder / name).parent.mkdir(exist_ok=True)
                    (self.folder / name).write_bytes(content)
                self.record(settings, num_devices, kept=[*kept])

    def settings(self) -> RunSettings:
        """Reads the settings back.

        Raises:
            InputError: the folder holds no run, or one that this version cannot read.
        """
        path = self.folder / "config.json"
        return files.read_settings(path, RunSettings, "run", former_versions.run_settings)

    def task(self) -> TaskSettings:
        """The settings of the run's task, which read the files kept here."""
        return self.settings().task.kept_in(self.folder)

    @primary_only
    def append(self, name: str, rows: Iterable[Row]) -> None:
        """Adds rows to a table, with a header when it is new."""
        path = self.folder / name
        text = csv_text(rows, header=not path.exists())
        with path.open("a", newline="") as file:
            file.write(text)

    def column(self, name: str, column: str, keep: Callable[[int], bool]) -> list[float]:
        """One column of a table, of the iterations that are wanted; NaN where a figure is missing.

        Raises:
            InputError: the table has no such column, or something else than numbers in it.
        """
        header, rows = self._read(name)
        if not rows:
            return []
        place = _place(self.folder / name, header, column)
        try:
            return [float(row[place] or "nan") for iteration, row in rows if keep(iteration)]
        except ValueError as error:
            raise InputError(f"{self.folder / name}: column {column} is damaged ({error})") from error

    @primary_only
    def roll_back(self, name: str, keep: Callable[[int], bool]) -> None:
        """Keeps only the whole rows of those iterations that are wanted.

        Raises:
            InputError: the table has no column of iterations.
        """
        header, rows = self._read(name)
        if header:
            kept = [",".join(row) + "\n" for iteration, row in rows if keep(iteration)]
            files.replace_file(self.folder / name, ",".join(header) + "\n" + "".join(kept))
        else:
            self.remove(name)

    def _read(self, name: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
        """A table's header and its whole rows by iteration; none where it lacks a whole first line."""
        path = self.folder / name
        text = path.read_text(errors="replace") if path.is_file() else ""
        whole = [line.split(",") for line in text.split("\n")[:-1]]
        if not whole or whole[0] == [""]:
            return [], []
        header, *rows = whole
        place = _place(path, header, "iteration")
        return header, [(int(r[place]), r) for r in rows if len(r) == len(header) and r[place].isdecimal()]

    @primary_only
    def remove(self, *names: str) -> None:
        """Removes files of the run, those that are there."""
        for name in names:
            (self.folder / name).unlink(missing_ok=True)

    @primary_only
    def write_json(self, name: str, content: dict[str, Any]) -> None:
        """Writes one JSON object."""
        files.replace_file(self.folder / name, files.json_text(content))

    def arrays(self, name: str, iteration: int) -> dict[str, np.ndarray]:
        """What `write_arrays` has kept of that name and iteration.

        Raises:
            InputError: there is none, or it is corrupt.
        """
        return read_plain_arrays(self._array_path(name, iteration))

    def iterations(self, name: str) -> list[int]:
        """The iterations at which arrays of that name were kept, rising."""
        return iterations_in(self.folder / name)

    @primary_only
    def write_arrays(self, name: str, iteration: int, arrays: dict[str, Any]) -> None:
        """Keeps arrays under a name and an iteration."""
        write_arrays(self._array_path(name, iteration), arrays)

    @primary_only
    def remove_arrays(self, name: str, keep: Callable[[int], bool]) -> None:
        """Keeps only the arrays of those iterations that are wanted."""
        for iteration in self.iterations(name):
            if not keep(iteration):
                self._array_path(name, iteration).unlink()

    def _array_path(self, name: str, iteration: int) -> Path:
        return by_iteration(self.folder / name, iteration)

    @primary_only
    def record(
        self, settings: RunSettings, num_devices: int, from_iteration: int = 0, kept: Iterable[str] = ()
    ) -> None:
        """Writes config.json: the settings, the facts when the run began, and one more session.

        Args:
            kept: the names of the task's files, where the run begins.
        """
        session = session_facts(num_devices, from_iteration)
        facts: dict[str, Any] = {"files": [*kept]} | {name: session[name] for name in FACTS}
        sessions = []
        if from_iteration:
            before = self._config()
            facts = {name: before.get(name) for name in ("files", *FACTS)}
            sessions = _sessions(before)
        config = {"settings": settings_tree.to_json(settings)} | facts | {"sessions": [*sessions, session]}
        self.write_json("config.json", config)

    def facts(self) -> dict[str, Any]:
        """What `environment_facts` said when the run was last trained, as far as its config.json says."""
        session = _sessions(self._config())[-1]
        return {name: session.get(name) for name in FACTS}

    def num_devices(self) -> int | None:
        """How many devices the run was last trained on, where its config.json says so."""
        found = self._of_last_session("devices", "used")
        return found if isinstance(found, int) else None

    def check_version(self) -> None:
        """Makes sure that the run was last trained by this version, as far as its config.json says.

        Raises:
            InputError: it was another one, whose states to resume from are of another kind.
        """
        there, here = self._of_last_session("versions", "pecjax"), importlib.metadata.version("pecjax")
        if there is not None and there != here:
            raise InputError(
                f"{self.folder}: holds a run of another version ({str(there)[:30]!r} there, {here!r} here); "
                "resume it with that one, or train anew in another folder"
            )

    def _of_last_session(self, part: str, name: str) -> Any:
        try:
            return _sessions(self._config())[-1][part][name]
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def _config(self) -> dict[str, Any]:
        return json.loads((self.folder / "config.json").read_text())

    def differences(self, settings: RunSettings) -> list[str]:
        """What a run resumed with these settings would do otherwise than before."""
        return list(settings_tree.differences(_what_matters(self.settings()), _what_matters(settings)))

    def identity(self) -> dict[str, Any]:
        """All that an iteration depends on: settings, the task's files and version."""
        names = self._config().get("files") or former_versions.FILES
        found = {name: self.folder / name for name in names if (self.folder / name).is_file()}
        return {
            "settings": _what_matters(self.settings()),
            "files": {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in found.items()},
            "version": importlib.metadata.version("pecjax"),
        }


def _sessions(config: dict[str, Any]) -> list[dict[str, Any]]:
    """The sessions that a config.json lists; older ones only have the facts of the last."""
    sessions = config.get("sessions")
    if isinstance(sessions, list) and sessions:
        return sessions
    return [{"from_iteration": 0, "started": None} | {name: config.get(name) for name in FACTS}]


def _place(path: Path, header: list[str], column: str) -> int:
    if column not in header:
        raise InputError(f"{path}: has no column {column}; restore the file or train anew in another folder")
    return header.index(column)


def _what_matters(settings: RunSettings) -> dict[str, Any]:
    """Settings that iterations depend on."""
    content = settings_tree.to_json(settings)
    return {name: value for name, value in content.items() if name != "stop"}
