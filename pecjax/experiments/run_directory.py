"""Run directories: the plain files that a run leaves behind, and how to read them again."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cattrs

from pecjax.errors import InputError
from pecjax.experiments import plain_files
from pecjax.experiments.presets import RunSettings
from pecjax.experiments.provenance import environment_facts
from pecjax.world.coordinates import Configurations, load_coordinates


class RunDirectory:
    """One run's folder. Tables grow row by row and are on disk after each."""

    def __init__(self, folder: Path) -> None:
        """Names the folder; nothing is read or written yet."""
        self.folder = folder
        self.scene_path = folder / "scene.xml"

    def create(
        self, settings: RunSettings, scene_path: Path, table: Configurations, num_devices: int
    ) -> None:
        """Writes what the run depends on: settings, map and coordinates."""
        scene = plain_files.scene_text(scene_path)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / "figures").mkdir()
            self.scene_path.write_text(scene)
            (self.folder / "coordinates.csv").write_text(plain_files.coordinates_text(table))
            config = {"settings": dataclasses.asdict(settings)} | environment_facts(num_devices)
            self.write_json("config.json", config)
        except OSError as error:
            raise InputError(
                f"{self.folder}: cannot be written ({error.strerror}); choose another --out"
            ) from error

    def settings(self) -> RunSettings:
        """Reads the settings back.

        Raises:
            InputError: the folder holds no run, or one that this version cannot read.
        """
        path = self.folder / "config.json"
        if not path.is_file():
            raise InputError(f"{self.folder}: no run here (config.json is missing); give a run's folder")
        try:
            return cattrs.structure(json.loads(path.read_text())["settings"], RunSettings)
        except (ValueError, KeyError, TypeError, cattrs.BaseValidationError) as error:
            raise InputError(
                f"{path}: cannot be read as a run's settings ({error}); give another run"
            ) from error

    def table(self) -> Configurations:
        """Reads the configurations back."""
        return load_coordinates(self.folder / "coordinates.csv")

    def append(self, name: str, rows: Iterable[plain_files.Row]) -> None:
        """Adds rows to a table, with a header when it is new."""
        path = self.folder / name
        text = plain_files.csv_text(rows, header=not path.exists())
        with path.open("a", newline="") as file:
            file.write(text)

    def write_json(self, name: str, content: dict[str, Any]) -> None:
        """Writes one JSON object."""
        (self.folder / name).write_text(plain_files.json_text(content))
