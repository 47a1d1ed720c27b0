"""Demos: runs that come with pecjax, to try a trained policy without training one."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "demos"
DEMOS = ("demo", "demo-set-1", "demo-set-2")


def is_demo(folder: Path) -> bool:
    """Whether it is the name of a demo; a folder of that name that is there comes first."""
    return str(folder) in DEMOS and not folder.exists()


def find_run(folder: Path) -> Path:
    """The folder of a run, or of the demo of that name."""
    return FOLDER / str(folder) if is_demo(folder) else folder
