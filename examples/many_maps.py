"""Thousands of maps in one program: halls with pillars, a policy trained in some and flown in others.

python examples/many_maps.py
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pecjax
from pecjax.envs.axes import make_table
from pecjax.envs.rooms import RoomsTask
from pecjax.envs.rooms.maps import MapBank
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.task import RoomsParams
from pecjax.envs.task import TaskSettings, World
from pecjax.runtime.devices import keep_compiled_programs, use_all_cores

HALF, HEIGHT = 8.0, 3.0  # m, of a hall
OUTER = np.array([[-8.2, -8.2, 8.2, -8], [-8.2, 8, 8.2, 8.2], [-8.2, -8, -8, 8], [8, -8, 8.2, 8]])


@dataclass(frozen=True)
class Halls(TaskSettings):
    """Each map is a hall with pillars, and one configuration that leads across it.

    Attributes:
        number: of maps.
        pillars: of each.
        seed: of all that is drawn; another one gives other maps of the same shapes.
    """

    number: int = 2000
    pillars: int = 10
    seed: int = 0

    def make(self) -> tuple[RoomsTask, World]:
        """The task and its world; between the pillars there is always a way."""
        draw = np.random.default_rng(self.seed)
        centre = draw.uniform((-5, -7), (5, 7), (self.number, self.pillars, 2))
        pillars = np.concatenate([centre - 0.3, centre + 0.3], axis=-1)  # x, y of both corners
        walls = np.concatenate([np.broadcast_to(OUTER, (self.number, *OUTER.shape)), pillars], axis=1)
        up = [(0, 0), (0, 0), (0, 1)]
        lower = np.pad(walls[..., :2], up, constant_values=0.0)
        upper = np.pad(walls[..., 2:], up, constant_values=HEIGHT)
        bounds = np.broadcast_to(np.array([[-8.2, -8.2], [8.2, 8.2]]), (self.number, 2, 2))
        bank = MapBank(*(array.astype(np.float32) for array in (lower, upper, bounds)))
        ends = draw.uniform(-7, 7, (2, self.number))
        table = make_table(
            pecjax.Configurations,
            start=np.stack([np.full(self.number, -7.0), ends[0]], axis=-1),
            goal=np.stack([np.full(self.number, 7.0), ends[1]], axis=-1),
            map_id=np.arange(self.number),
        )
        vehicle = pecjax.load_scene().vehicle
        task = RoomsTask(vehicle, NavigationSettings(max_steps=300), one_map=False)
        return task, World(RoomsParams(bank), table)


def main(iterations: int = 150, number: int = 2000) -> tuple[float, float]:
    """Trains; returns and prints the goal ratio in the maps of the training and in others."""
    settings = pecjax.RunSettings(task=Halls(number))
    settings = pecjax.set_path(settings, "stop.iterations", iterations)
    evaluate = pecjax.train(settings).trained.evaluator()
    seen = float(evaluate().success.mean())
    unseen = float(evaluate(Halls(number, seed=1).make()[1]).success.mean())
    print(f"goal ratio in the maps of the training {seen:.3f}, in maps never seen {unseen:.3f}")
    return seen, unseen


if __name__ == "__main__":
    use_all_cores()
    keep_compiled_programs()
    main()
