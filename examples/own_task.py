"""A task of your own, with continuous actions: a puck is pushed to a place on a slippery table.

python examples/own_task.py
pecjax train --task own_task:PuckSettings --task.number 8    (in this folder)
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

import pecjax
from pecjax.agents import PPO
from pecjax.envs.axes import axis, make_table
from pecjax.envs.spaces import Box
from pecjax.envs.task import Transition, World


@struct.dataclass
class Table:
    """What differs between episodes: a single axis."""

    friction: Any = axis("friction", unit="1/s", low=0)


class Puck(pecjax.Task):
    """Push, by -1 to 1 m/s², until it lies near the goal. The time limit is no part of the task."""

    observation_space, action_space = Box((2,)), Box((1,), -1.0, 1.0)
    max_steps, truncates = 200, True
    metrics: ClassVar = {"effort": "mean"}

    def reset(self, key, config, params):
        """At rest, up to 2 m away."""
        place = jax.random.uniform(key, minval=-2, maxval=2)
        return {"place": place, "speed": jnp.zeros(()), "steps": jnp.int32(0), "config": config}

    def step(self, key, state, action, params):
        """50 ms under a push."""
        effort = action[0] ** 2
        speed = state["speed"] + 0.05 * (action[0] - state["config"].friction * state["speed"])
        place, steps = state["place"] + 0.05 * speed, state["steps"] + 1
        after = state | {"place": place, "speed": speed, "steps": steps}
        there = (jnp.abs(place) < 0.1) & (jnp.abs(speed) < 0.2)
        reward = 10.0 * there - jnp.abs(place) - 0.05 * effort
        return Transition(after, reward, there, steps >= 200, there, {"effort": effort})

    def observe(self, key, state, params):
        """Place (m) and speed (m/s), seen from the goal."""
        return jnp.stack([state["place"], state["speed"]])


@dataclass(frozen=True)
class PuckSettings(pecjax.TaskSettings):
    """Frictions from 0 to 2 1/s."""

    number: int = 20

    def make(self):
        """The task and its world."""
        return Puck(), World((), make_table(Table, friction=np.linspace(0, 2, self.number)))


def main(iterations=80):
    """Trains, prints the last evaluation, and returns it."""
    agent = PPO(reward_scale=0.1, learning_rate=1e-3, entropy_coeff=0.0)
    settings = pecjax.RunSettings(task=PuckSettings(), agent=agent)
    settings = pecjax.set_path(settings, "stop.iterations", iterations)
    row = pecjax.train(settings).evaluation[-1]
    print(row)
    return row


if __name__ == "__main__":
    main()
