"""Tasks that only a memory solves: what matters is seen once, and asked for later."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from probe_tasks import Numbers

from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, Transition


class Walk(NamedTuple):
    steps: jax.Array
    signal: jax.Array
    config: Numbers


class Recall(Task):
    """A signal of two is seen at the first step alone, and after `delay` more steps is to be named.

    The right name pays 1, the wrong one -1; all other actions do nothing.
    """

    observation_space = Box((3,), 0.0, 1.0)
    action_space = Discrete(2)

    def __init__(self, delay):
        """Signal at step 0, answer at step `delay`."""
        self.delay = delay
        self.max_steps = delay + 1

    def reset(self, key, config, params):
        return Walk(jnp.zeros((), jnp.int32), jax.random.bernoulli(key).astype(jnp.int32), config)

    def step(self, key, state, action, params):
        done, right = state.steps == self.delay, action == state.signal
        reward = jnp.where(done, jnp.where(right, 1.0, -1.0), 0.0)
        never = jnp.zeros((), bool)
        return Transition(state._replace(steps=state.steps + 1), reward, done, never, done & right, {})

    def observe(self, key, state, params):
        first, last = state.steps == 0, state.steps == self.delay
        return jnp.stack([first * (state.signal == 0), first * (state.signal == 1), last]).astype(jnp.float32)


class Maze(NamedTuple):
    place: jax.Array
    steps: jax.Array
    signal: jax.Array
    config: Numbers


class TMaze(Task):
    """A corridor, and at its end a turn to the left or right, as a sign at the corridor's beginning says.

    Actions are back, forth, left and right; the drone sees whether it stands at the beginning (with the
    sign), in the corridor or at the end, as in Bakker 2001, "Reinforcement learning with long short-term
    memory". The right turn pays 4, the wrong one -1, and every step that leads nowhere -0.1.
    """

    LENGTH = 6
    observation_space = Box((4,), 0.0, 1.0)
    action_space = Discrete(4)
    max_steps = 40

    def reset(self, key, config, params):
        zero = jnp.zeros((), jnp.int32)
        return Maze(zero, zero, jax.random.bernoulli(key).astype(jnp.int32), config)

    def step(self, key, state, action, params):
        at_end, turns = state.place == self.LENGTH, action >= 2
        place = jnp.clip(state.place + jnp.where(turns, 0, 2 * action - 1), 0, self.LENGTH)
        done, right = at_end & turns, action - 2 == state.signal
        late = (state.steps + 1 >= self.max_steps) & ~done
        reward = jnp.where(done, jnp.where(right, 4.0, -1.0), jnp.where(place == state.place, -0.1, 0.0))
        state = state._replace(place=place, steps=state.steps + 1)
        return Transition(state, reward, done | late, jnp.zeros((), bool), done & right, {})

    def observe(self, key, state, params):
        start, end = state.place == 0, state.place == self.LENGTH
        seen = [start & (state.signal == 0), start & (state.signal == 1), ~start & ~end, end]
        return jnp.stack(seen).astype(jnp.float32)
