"""An unmodified environment of gymnax under PEC: poles of many lengths, drawn by how often they fall.

    pip install gymnax
    python examples/gymnax_cartpole.py

The same from the command line, in this folder:

    pecjax train --task gymnax_cartpole:Poles --sampler uniform --iterations 60
"""

from __future__ import annotations

from dataclasses import dataclass

import gymnax
import numpy as np

import pecjax
from pecjax.agents import PPO
from pecjax.envs.gymnax import GymnaxTask, params_table, survived
from pecjax.envs.task import TaskSettings, World
from pecjax.runtime.devices import keep_compiled_programs, use_all_cores


@dataclass(frozen=True)
class Poles(TaskSettings):
    """CartPole with poles from short and quick to long and slow.

    Attributes:
        number: how many.
    """

    number: int = 20

    def make(self) -> tuple[GymnaxTask, World]:
        """The task and its world."""
        env, params = gymnax.make("CartPole-v1")
        length = np.geomspace(0.1, 2.5, self.number)
        table = params_table(params, length=length, polemass_length=params.masspole * length)
        return GymnaxTask(env, params, survived), World((), table)


def main(iterations: int = 100) -> float:
    """Trains, and returns and prints the share of poles that stand for 500 steps."""
    agent = PPO(reward_scale=0.1, learning_rate=1e-3)
    settings = pecjax.RunSettings(task=Poles(), agent=agent)
    settings = pecjax.set_path(settings, "stop.iterations", iterations)
    result = pecjax.train(settings)
    print("goal ratio by length:", np.round(result.trained.evaluator()().goal_ratios(), 2))
    return result.evaluation[-1]["goal_ratio"]


if __name__ == "__main__":
    use_all_cores()
    keep_compiled_programs()
    main()
