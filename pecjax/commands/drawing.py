"""Drawing, imported only where it is used: pandas and matplotlib would hold up the rest by 2 s."""

from __future__ import annotations

import importlib
from pathlib import Path

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.scene import Scene


def draw(folder: Path) -> list[Path]:
    """Draws every figure of a run or a study into its folder; returns the files.

    Raises:
        InputError: the folder holds neither, or nothing to draw yet.
    """
    if (folder / "study.json").is_file():
        return importlib.import_module("pecjax.plotting.study").draw_study(folder)
    return importlib.import_module("pecjax.plotting.run").draw_run(folder)


def draw_map(scene: Scene, table: Configurations, stem: Path) -> list[Path]:
    """Draws a map and its configurations to `stem`.png and .svg."""
    figure = importlib.import_module("pecjax.plotting.maps").rooms(scene, table)
    return importlib.import_module("pecjax.plotting.style").save(figure, stem)
