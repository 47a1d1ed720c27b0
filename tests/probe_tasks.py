"""Tasks so small that their values are known, and without the edges that rounding can tip over."""

import jax.numpy as jnp
import numpy as np
from brax.envs.base import State

import pecjax
from pecjax.envs.rooms.navigation import FlightState
from pecjax.envs.rooms.vehicle import Camera

FAR = 10.0


class TwoStates:
    """Two rooms A and B. Staying pays 0.1 in A and -0.1 in B; going on leads from A to B for
    nothing, and from B out of it all for 1."""

    scene = type("Scene", (), {"camera": Camera(np.zeros(3), np.eye(3), np.pi / 2, 1, 1, 0.0, FAR)})
    action_size = 2

    def place(self, config, heading):
        zero, no_steps = jnp.zeros(()), jnp.zeros((), jnp.int32)
        flight = FlightState((heading > 0).astype(jnp.int32), zero, config, no_steps, no_steps)
        return State(flight, {}, zero, zero, {"goal": zero, "unstable": zero})

    def observe(self, state):
        room = state.pipeline_state.qpos.astype(jnp.float32)
        return state.replace(obs={"depth": jnp.full((1, 1), 5.0), "goal": jnp.stack([10 * room, 0 * room])})

    def advance(self, state, action):
        flight, on = state.pipeline_state, action == 1
        room = flight.qpos
        reward = jnp.where(on, jnp.where(room == 1, 1.0, 0.0), jnp.where(room == 1, -0.1, 0.1))
        done = (on & (room == 1)).astype(jnp.float32)
        flight = flight._replace(qpos=jnp.where(on, 1, room), step_count=flight.step_count + 1)
        return state.replace(
            pipeline_state=flight,
            reward=reward,
            done=done,
            metrics={"goal": done, "unstable": jnp.zeros(())},
        )


TABLE = pecjax.Configurations(np.zeros((3, 2), np.float32), np.ones((3, 2), np.float32))
