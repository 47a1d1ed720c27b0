"""A further axis of the configurations: fog, beyond which the drone's camera sees nothing.

    python examples/own_axis.py

The same from the command line, in this folder, with any file that has a column `visibility`:

    pecjax train --task own_axis:FoggyRooms --coordinates fog.csv
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
class Foggy(pecjax.Configurations):
    """Start and goal, as ever, and how far the camera sees."""

    visibility: Any = axis("visibility", unit="m", default=10.0, low=0.1)


class FoggyTask(RoomsTask):
    """The rooms, where fog hides what lies beyond."""

    def observe(self, key: Any, state: Any, params: Any) -> Any:
        """What lies beyond the fog looks as far as the fog."""
        seen = super().observe(key, state, params)
        share = state.config.visibility / self.vehicle.camera.far
        return seen | {"depth": jnp.minimum(seen["depth"], share)}


@dataclass(frozen=True)
class FoggyRooms(pecjax.Rooms):
    """The rooms with fog."""

    task_kind: ClassVar = FoggyTask
    configurations_kind: ClassVar = Foggy


def main(iterations: int = 300, episodes: int = 20, folder: Path = Path("runs/own_axis")) -> np.ndarray:
    """Trains in clear air and in fog, and returns and prints the goal ratio by visibility."""
    folder.mkdir(parents=True, exist_ok=True)
    table, sights = pecjax.COORDINATE_SET_1, (10.0, 2.0, 0.5)
    lines = [
        f"{x:g}, {y:g}, {goal_x:g}, {goal_y:g}, {sight:g}"
        for (x, y), (goal_x, goal_y) in zip(table.start, table.goal, strict=True)
        for sight in sights
    ]
    file = folder / "fog.csv"
    file.write_text("\n".join(["start_x, start_y, goal_x, goal_y, visibility", *lines]) + "\n")
    settings = pecjax.RunSettings(task=FoggyRooms(table=str(file)))
    settings = pecjax.set_path(settings, "stop.iterations", iterations)
    settings = pecjax.set_path(settings, "evaluation.episodes", episodes * len(lines))
    run = pecjax.train(settings, folder / "run").trained
    ratios = run.evaluator()().goal_ratios().reshape(-1, len(sights)).mean(axis=0)
    for sight, ratio in zip(sights, ratios, strict=True):
        print(f"visibility {sight:4g} m: goal ratio {ratio:.3f}")
    return ratios


if __name__ == "__main__":
    use_all_cores()
    keep_compiled_programs()
    main()
