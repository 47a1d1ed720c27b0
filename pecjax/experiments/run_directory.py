"""Run directories: the plain files that a run leaves behind, and how to read them again."""

from __future__ import annotations

import csv
import dataclasses
import importlib.metadata
import json
import os
import platform
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cattrs
import jax
import mujoco
import numpy as np

from pecjax.errors import InputError
from pecjax.experiments.presets import RunSettings
from pecjax.world.coordinates import Configurations, load_coordinates

_PACKAGES = ("pecjax", "jax", "mujoco", "mujoco-mjx", "flax", "optax", "numpy")


def environment_facts(num_devices: int) -> dict[str, Any]:
    """Versions, machine, devices and git commit: what a figure needs to be believed."""
    return {
        "versions": {name: importlib.metadata.version(name) for name in _PACKAGES}
        | {"python": platform.python_version()},
        "machine": {"system": platform.platform(), "cores": os.cpu_count(), "processor": _processor()},
        "devices": {
            "kind": jax.devices()[0].device_kind,
            "used": num_devices,
            "available": len(jax.devices()),
        },
        "git_commit": _git_commit(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def _git_commit() -> str | None:
    """The commit of the checkout this package runs from, None outside one."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()


def _as_one_file(scene_path: Path) -> str:
    """The map with all that it includes, as the run flies in it and keeps it.

    Raises:
        InputError: it needs files that are not MJCF.
    """
    spec = mujoco.MjSpec.from_file(str(scene_path))
    for asset in (*spec.meshes, *spec.textures, *spec.hfields, *spec.skins):
        if getattr(asset, "file", ""):
            raise InputError(
                f"{scene_path}: needs the file '{asset.file}', but a run keeps its map as one file; "
                "take the asset out or draw it with plain geoms"
            )
    return spec.to_xml()


def check_free(folder: Path) -> None:
    """Makes sure that a new run can be written into `folder`, without leaving anything there.

    Raises:
        InputError: the folder holds something already, or cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; give a folder for the run with --out")
    if folder.is_dir() and any(folder.iterdir()):
        held = "holds another run" if (folder / "config.json").exists() else "is not empty"
        raise InputError(f"{folder}: {held}; give another folder with --out")
    nearest = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: {nearest} cannot be written; give another folder with --out")


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
        scene = _as_one_file(scene_path)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / "figures").mkdir()
            self.scene_path.write_text(scene)
            rows = np.hstack([table.start, table.goal])
            np.savetxt(
                self.folder / "coordinates.csv", rows, "%.9g", ",", header="start_x,start_y,goal_x,goal_y"
            )
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

    def append(self, name: str, rows: Iterable[dict[str, Any]]) -> None:
        """Adds rows to a table, with a header when it is new."""
        path = self.folder / name
        new = not path.exists()
        with path.open("a", newline="") as file:
            for row in rows:
                writer = csv.DictWriter(file, fieldnames=list(row), lineterminator="\n")
                if new:
                    writer.writeheader()
                    new = False
                writer.writerow({key: _plain(value) for key, value in row.items()})

    def write_json(self, name: str, content: dict[str, Any]) -> None:
        """Writes one JSON object."""
        (self.folder / name).write_text(json.dumps(content, indent=2) + "\n")


def _plain(value: Any) -> Any:
    """Seven digits are all that float32 holds; a missing figure is an empty field."""
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value:.7g}"
    return value
