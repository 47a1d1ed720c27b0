"""Flights under Brax's own wrappers, one action all the time."""

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.wrappers import training


def wrapped_flight(env, action, steps, episode_length, key=jax.random.PRNGKey, wrap=training.wrap):
    """(state after reset, rows of done, truncation and what `info` says) under Brax's wrappers."""
    wrapped = wrap(env, episode_length=episode_length)
    first = jax.jit(wrapped.reset)(jax.random.split(key(2), 4))

    def step(state, _):
        state = wrapped.step(state, jnp.full(4, action))
        kept = ("done", state.done), ("truncation", state.info["truncation"]), ("steps", state.info["steps"])
        return state, dict(kept) | state.metrics | {"counted": state.pipeline_state.step_count}

    last, rows = jax.jit(lambda state: jax.lax.scan(step, state, None, steps))(first)
    return first, last, jax.tree.map(np.asarray, rows)


def ends_of(rows):
    return [np.flatnonzero(row).tolist() for row in rows["done"].T]


def evaluated(env, episode_length):
    return training.EvalWrapper(training.wrap(env, episode_length=episode_length))
