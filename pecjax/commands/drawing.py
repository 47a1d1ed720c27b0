"""Drawing, imported only where it is used: pandas and matplotlib would hold up the rest by 2 s."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.plans.plans import Plans
from pecjax.envs.rooms.scene import Scene
from pecjax.envs.rooms.spaces.space import Space
from pecjax.training.eval_report import Report


def draw(folder: Path) -> list[Path]:
    """Draws every figure of a run or a study into its folder; returns the files.

    Raises:
        InputError: the folder holds neither, or nothing to draw yet.
    """
    if (folder / "study.json").is_file():
        return importlib.import_module("pecjax.plotting.study").draw_study(folder)
    return importlib.import_module("pecjax.plotting.run").draw_run(folder)


def draw_benchmark(folder: Path) -> list[Path]:
    """Draws the figures of the benchmark of samplers from its results."""
    return importlib.import_module("pecjax.plotting.benchmark").draw_benchmark(folder)


def draw_evaluation(report: Report, out: Path) -> list[Path]:
    """Draws the report of an evaluation."""
    return _save("evaluation", "evaluation", out, report)


def draw_map(scene: Scene, table: Configurations, out: Path) -> list[Path]:
    """Draws a map and its configurations."""
    return _save("maps", "rooms", out, scene, table)


def draw_space(space: Space, out: Path) -> list[Path]:
    """Draws how the configurations of a space are spread."""
    return _save("spaces", "space_figure", out, space)


def draw_plans(plans: Plans, per_family: int, out: Path) -> list[Path]:
    """Draws some plans of each family."""
    return _save("contact_sheet", "contact_sheet", out, plans, per_family)


def _save(module: str, function: str, out: Path, *args: Any) -> list[Path]:
    """Saves what a plotting function draws, as `style.save` does."""
    figure = getattr(importlib.import_module(f"pecjax.plotting.{module}"), function)(*args)
    return importlib.import_module("pecjax.plotting.style").save(figure, out)
