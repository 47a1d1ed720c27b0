"""Tasks so small that their values are known, and without the edges that rounding can tip over."""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pecjax.envs.axes import axis
from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, Transition, World


@struct.dataclass
class Numbers:
    """Configurations that are just told apart."""

    number: jax.Array = axis("number")


WORLD = World((), Numbers(np.arange(3, dtype=np.float32)))


class Room(NamedTuple):
    room: jax.Array
    config: Numbers


class TwoStates(Task):
    """Two rooms A and B. Staying pays 0.1 in A and -0.1 in B; going on leads from A to B for
    nothing, and from B out of it all for 1."""

    observation_space = Box((2,), 0.0, 1.0)
    action_space = Discrete(2)
    max_steps = 1000

    def reset(self, key, config, params):
        return Room(jax.random.bernoulli(key).astype(jnp.int32), config)

    def step(self, key, state, action, params):
        on, last = action == 1, state.room == 1
        reward = jnp.where(on, jnp.where(last, 1.0, 0.0), jnp.where(last, -0.1, 0.1))
        done, never = on & last, jnp.zeros((), bool)
        return Transition(state._replace(room=jnp.where(on, 1, state.room)), reward, done, never, done, {})

    def observe(self, key, state, params):
        return jnp.stack([1.0 - state.room, 1.0 * state.room])


class Counted(NamedTuple):
    steps: jax.Array
    config: Numbers


class CutOff(Task):
    """One state that pays 1 a step for ever, of which an episode sees but five steps.

    Its value is 1 / (1 - discount) where the cut is bootstrapped across, and less where it is not.
    """

    observation_space = Box((1,), 0.0, 1.0)
    action_space = Discrete(2)
    max_steps = 5
    truncates = True

    def reset(self, key, config, params):
        return Counted(jnp.zeros((), jnp.int32), config)

    def step(self, key, state, action, params):
        steps = state.steps + 1
        over, never = steps >= self.max_steps, jnp.zeros((), bool)
        return Transition(state._replace(steps=steps), jnp.float32(1), never, over, over, {})

    def observe(self, key, state, params):
        return jnp.ones(1)


class Target(Task):
    """One step: the nearer the action is to the configuration's target, the more it pays, 0 at most."""

    observation_space = Box((1,), -1.0, 1.0)
    action_space = Box((2,), -2.0, 2.0)
    max_steps = 1
    metrics: ClassVar = {"distance": "mean"}

    def reset(self, key, config, params):
        return Counted(jnp.zeros((), jnp.int32), config)

    def step(self, key, state, action, params):
        target = params * (state.config.number - 1)  # of the first part; the second's is 1
        off = jnp.square(action - jnp.stack([target, jnp.ones(())])).sum()
        done, near = jnp.ones((), bool), off < 0.25
        return Transition(state, -off, done, jnp.zeros((), bool), near, {"distance": jnp.sqrt(off)})

    def observe(self, key, state, params):
        return (state.config.number - 1)[None]


TARGET_WORLD = World(jnp.float32(0.8), Numbers(np.arange(3, dtype=np.float32)))
