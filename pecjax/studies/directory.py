"""Study directories: finished batches, each whole or absent, and the tables merged from them."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pecjax import settings_tree
from pecjax.envs.task import TaskSettings
from pecjax.errors import InputError
from pecjax.runtime.provenance import environment_facts, short_commit
from pecjax.storage import files
from pecjax.storage.arrays import read_plain_arrays
from pecjax.storage.tables import csv_text, joined_tables
from pecjax.studies.collect import Collected
from pecjax.studies.grid import StudySettings
from pecjax.training import former_versions

_SUMS = "SHA256SUMS"
_PROVENANCE = "provenance.json"  # of a batch; no times in it: the same code writes the same bytes
_DIVERGED = "diverged.txt"  # of a batch, where some of its runs are not in its tables
_CONFIGURATIONS = "configurations.npz"


class StudyDirectory:
    """One study's folder: `study.json`, the files of its tasks, `batches/`, and the tables.

    The tables are `results.csv` (a row an evaluation) and `metrics.csv` (a row an iteration). Trials and
    failures of each configuration so far, at every evaluation, are arrays in the batches.
    """

    TABLES = ("results", "metrics")

    def __init__(self, folder: Path) -> None:
        """Names the folder; nothing is read or written yet."""
        self.folder = folder
        self._batches = folder / "batches"
        self._started = folder / ".study.json.new"
        self._facts: dict[str, Any] = {}

    def settings(self) -> StudySettings:
        """Reads the settings back.

        Raises:
            InputError: the folder holds no study, or one that this version cannot read.
        """
        path = self.folder / "study.json"
        return files.read_settings(path, StudySettings, "study", former_versions.study_settings)

    def task(self, number: int, settings: TaskSettings) -> TaskSettings:
        """The settings of one of the study's tasks, which read the files kept here.

        Args:
            number: its place among the study's tasks, in the order of its runs.
        """
        kept = self.folder / f"task-{number}"
        return settings.kept_in(kept) if kept.is_dir() else former_versions.study_task(settings, self.folder)

    @contextlib.contextmanager
    def open(
        self, settings: StudySettings, tasks: Sequence[TaskSettings], num_devices: int
    ) -> Iterator[None]:
        """Begins a study, or makes sure that the folder holds this very one; locks it while entered.

        Raises:
            InputError: the folder holds something else (another study, or this one started with other
                settings, another map or other versions), another process writes into it, or it
                cannot be written.
        """
        self._facts = environment_facts(num_devices)
        content = {"settings": settings_tree.to_json(settings)} | self._facts
        kept = {
            f"task-{number}/{name}": held
            for number, task in enumerate(tasks)
            for name, held in task.files().items()
        }
        self._check_free()  # before the folder is made, which the lock needs
        with files.writing(self.folder, "choose another --out"):
            self.folder.mkdir(parents=True, exist_ok=True)
        with files.alone(self.folder):
            self._check_free()  # another study may have started here meanwhile
            if (self.folder / "study.json").is_file():
                self._compare(json.loads(files.json_text(content)), kept)
            else:
                self._create(content, kept)
            yield

    def _check_free(self) -> None:
        if not (self.folder / "study.json").is_file() and not self._started.exists():
            files.check_free(self.folder)

    def _create(self, content: dict[str, Any], kept: dict[str, bytes]) -> None:
        with files.writing(self.folder, "choose another --out"):
            # Begins as another file: a study that is killed meanwhile knows its folder again.
            self._started.write_text(files.json_text(content))
            self._batches.mkdir(exist_ok=True)
            for name, held in kept.items():
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                (self.folder / name).write_bytes(held)
            os.replace(self._started, self.folder / "study.json")

    def _compare(self, content: dict[str, Any], kept: dict[str, bytes]) -> None:
        settings = settings_tree.to_json(self.settings())  # as they are written today
        versions = json.loads((self.folder / "study.json").read_text()).get("versions")
        differing = [
            *settings_tree.differences(_by_path(settings), _by_path(content["settings"])),
            *settings_tree.differences(versions, content["versions"]),
        ]
        for name, held in kept.items():
            path = self.folder / name
            if not path.is_file() or path.read_bytes() != held:
                differing.append(f"the content of {name}")
        if differing:
            raise InputError(
                f"{self.folder}: holds a study that differs in {', '.join(differing)}; "
                "give another folder with --out"
            )

    def verify(self, number: int) -> Iterator[str]:
        """Removes batches that are not what was written; yields lines that say what was found.

        Args:
            number: of batches that the study is made of.
        """
        self._batches.mkdir(exist_ok=True)
        for left_over in self._batches.glob(".[0-9]*"):  # written when the study was stopped
            shutil.rmtree(left_over)
        for path in self._held(number):
            if not _is_whole(path):
                shutil.rmtree(path)
                yield f"{path}: not as it was written; made again"
        there = len(self._held(number))
        yield f"{self.folder}: {there} of {number} batches are there"
        started = json.loads((self.folder / "study.json").read_text()).get("git_commit")
        now = self._facts["git_commit"]
        if there and started and now and started != now:
            yield (
                f"{self.folder}: started at commit {short_commit(str(started))} and resumed at "
                f"{short_commit(now)}; what is there stays"
            )

    def holds(self, number: int) -> bool:
        """Whether that batch is finished."""
        return self._batch_path(number).is_dir()

    def _batch_path(self, number: int) -> Path:
        return self._batches / f"{number:04}"

    def write_batch(self, number: int, collected: Collected) -> None:
        """Writes a finished batch, whole or not at all, and what it was made by."""
        new = self._batches / f".{number:04}"
        new.mkdir()
        tables = {"results": collected.table("evaluation"), "metrics": collected.table("metrics")}
        content = {f"{name}.csv": csv_text(rows).encode() for name, rows in tables.items()}
        content[_PROVENANCE] = files.json_text(self._facts).encode()
        arrays = io.BytesIO()
        save: Any = np.savez  # whose own arguments no array is named like
        save(arrays, **collected.configurations())
        content[_CONFIGURATIONS] = arrays.getvalue()
        if collected.diverged:
            content[_DIVERGED] = "".join(f"{line}\n" for line in collected.diverged.values()).encode()
        for name, bytes_ in content.items():
            (new / name).write_bytes(bytes_)
        sums = [f"{hashlib.sha256(bytes_).hexdigest()}  {name}\n" for name, bytes_ in content.items()]
        (new / _SUMS).write_text("".join(sums))
        os.replace(new, self._batch_path(number))

    def diverged(self, number: int) -> list[str]:
        """The runs of so many batches that diverged, in words, and how to try them again."""
        return [
            f"{line} (remove {path.parent} to try again)"
            for path in (batch / _DIVERGED for batch in self._held(number))
            if path.is_file()
            for line in path.read_text().splitlines()
        ]

    def has_rows(self) -> bool:
        """Whether a run has finished: whether the tables say anything."""
        return bool((self.folder / "results.csv").read_text().strip())

    def _held(self, number: int) -> list[Path]:
        return [self._batch_path(n) for n in range(number) if self.holds(n)]

    def merge_tables(self, number: int) -> None:
        """Writes the tables anew from those of so many batches that are there, in their order."""
        for name in self.TABLES:
            texts = [(path / f"{name}.csv").read_text() for path in self._held(number)]
            files.replace_file(self.folder / f"{name}.csv", joined_tables(texts))

    def rebuild_tables(self) -> list[str]:
        """Writes the tables anew from the batches; says how many are there, and which runs diverged.

        Raises:
            InputError: the folder holds no study or no batch, one of them is not as it was written, another
                process writes into the folder, or it cannot be written.
        """
        number = len(self.settings().batches())
        held = self._held(number)
        damaged = [path for path in held if not _is_whole(path)]
        if damaged:
            raise InputError(f"{damaged[0]}: not as it was written; resume the study, which makes it again")
        if not held:
            raise InputError(f"{self._batches}: none is there; resume the study")
        with files.alone(self.folder), files.writing(self.folder, "the same command writes them once it can"):
            self.merge_tables(number)
        return [f"{self.folder}: {len(held)} of {number} batches are there", *self.diverged(number)]

    def configurations(self, number: int) -> Iterator[tuple[Path, dict[str, np.ndarray]]]:
        """Of each of so many batches that is there, its folder and what `Collected.configurations` gave."""
        for path in self._held(number):
            yield path, read_plain_arrays(path / _CONFIGURATIONS)


def _by_path(settings: dict[str, Any]) -> dict[str, Any]:
    """A study's settings with its grid by path, so that differences have short names."""
    grid = settings["grid"]
    return settings | {"grid": dict(grid), "order of the grid": [path for path, _ in grid]}


def _is_whole(path: Path) -> bool:
    """Whether a batch's files are those that its checksums were taken of."""
    try:
        lines = (path / _SUMS).read_text().splitlines()
        sums = {name: digest for digest, name in (line.split("  ") for line in lines)}
        found = {name: hashlib.sha256((path / name).read_bytes()).hexdigest() for name in sums}
    except (OSError, ValueError):
        return False
    needed = {f"{name}.csv" for name in StudyDirectory.TABLES} | {_CONFIGURATIONS}
    return found == sums and needed <= set(sums) <= needed | {_PROVENANCE, _DIVERGED}
