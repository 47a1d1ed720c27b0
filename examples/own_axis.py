"""A further axis of the configurations: blinkers, which leave the camera a narrower view.

    python examples/own_axis.py

The same from the command line, in this folder, with any file that has a column `view`:

    pecjax train --task own_axis:NarrowRooms --coordinates narrow.csv
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from flax import struct

import pecjax
from pecjax.envs.axes import axis
from pecjax.envs.rooms import RoomsTask
from pecjax.runtime.devices import keep_compiled_programs, use_all_cores


@struct.dataclass
class Narrow(pecjax.Configurations):
    """Start and goal, as ever, and how much of its image the camera keeps."""

    view: Any = axis("view", default=1.0, low=0, high=1)


class NarrowTask(RoomsTask):
    """The rooms, seen between blinkers."""

    def observe(self, key: Any, state: Any, params: Any) -> Any:
        """Columns beyond the view read the camera's far end."""
        seen = super().observe(key, state, params)
        from_middle = np.abs(np.linspace(-1, 1, self.vehicle.camera.width))
        return seen | {"depth": jnp.where(from_middle <= state.config.view, seen["depth"], 1.0)}


@dataclass(frozen=True)
class NarrowRooms(pecjax.Rooms):
    """The rooms with blinkers."""

    task_kind: ClassVar = NarrowTask
    configurations_kind: ClassVar = Narrow


def main(iterations: int = 300, episodes: int = 20, folder: Path = Path("runs/own_axis")) -> np.ndarray:
    """Trains with and without blinkers, and returns and prints the goal ratio by view."""
    folder.mkdir(parents=True, exist_ok=True)
    table, views = pecjax.COORDINATE_SET_1, (1.0, 0.5, 0.0)
    lines = [
        f"{x:g}, {y:g}, {goal_x:g}, {goal_y:g}, {view:g}"
        for (x, y), (goal_x, goal_y) in zip(table.start, table.goal, strict=True)
        for view in views
    ]
    file = folder / "narrow.csv"
    file.write_text("\n".join(["start_x, start_y, goal_x, goal_y, view", *lines]) + "\n")
    settings = pecjax.RunSettings(task=NarrowRooms(table=str(file)))
    settings = pecjax.set_path(settings, "stop.iterations", iterations)
    settings = pecjax.set_path(settings, "evaluation.episodes", episodes * len(lines))
    run = pecjax.train(settings, folder / "run").trained
    ratios = run.evaluator()().goal_ratios().reshape(-1, len(views)).mean(axis=0)
    for view, ratio in zip(views, ratios, strict=True):
        print(f"view {view:4g}: goal ratio {ratio:.3f}")
    return ratios


if __name__ == "__main__":
    use_all_cores()
    keep_compiled_programs()
    main()
