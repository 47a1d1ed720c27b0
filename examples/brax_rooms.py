"""The drone in its rooms under Brax's PPO, with PEC choosing start and goal.

    python examples/brax_rooms.py

Brax's PPO gives continuous actions and takes flat observations, so an adapter stands between: an action is a
speed and a yaw rate from -1 to 1, rounded to the nearest that the drone has (three and five, evenly spaced);
depth image and goal come as one vector. It needs a JAX before 0.10: Brax 0.14.2's PPO calls a function that
newer ones do not have (Brax's issue 671).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import State, Wrapper
from brax.training.agents.ppo import train as ppo

import pecjax
from pecjax.curriculum import pec
from pecjax.curriculum.wrappers.brax import curriculum_wrap
from pecjax.envs.rooms.task import SPEEDS, YAW_RATES
from pecjax.runtime.devices import keep_compiled_programs, use_all_cores

SIZES = {"num_timesteps": 4_000_000, "num_envs": 512, "batch_size": 128, "num_minibatches": 4}
LEARNING = {"unroll_length": 32, "discounting": 0.99, "learning_rate": 3e-4, "reward_scaling": 0.01}
OTHERS = {"episode_length": 300, "normalize_observations": True, "entropy_cost": 1e-2}


class ContinuousRooms(Wrapper):
    """`RoomsNavigation` as Brax's PPO wants an environment to be."""

    action_size = 2

    def reset(self, rng: jax.Array) -> State:
        """Starts an episode in a configuration drawn uniformly."""
        return flat(self.env.reset(rng))

    def reset_to(self, config: Any, rng: jax.Array) -> State:
        """Starts an episode in `config`, one row of a table."""
        return flat(self.env.reset_to(config, rng))

    def step(self, state: State, action: jax.Array) -> State:
        """One control period at the speed and the yaw rate nearest to `action`, (2,) from -1 to 1."""
        greatest = jnp.array([len(SPEEDS) - 1, len(YAW_RATES) - 1])
        speed, yaw_rate = jnp.round((action + 1) / 2 * greatest).astype(jnp.int32)
        return flat(self.env.step(state, speed * len(YAW_RATES) + yaw_rate))


def flat(state: State) -> State:
    """The state with its observation as one vector."""
    return state.replace(obs=jnp.concatenate([state.obs["depth"].ravel(), state.obs["goal"]]))


def failed(state: State) -> jax.Array:
    """Whether episodes that end here have not reached their goals, (B,)."""
    return state.metrics["goal"] == 0


def main(every: int = 100, **changes: Any) -> list[Any]:
    """Trains, prints the counts of each configuration, and returns the sampler's states."""
    told: list[Any] = []
    rooms = pecjax.RoomsNavigation(pecjax.load_scene(), settings=pecjax.NavigationSettings(max_steps=300))
    table = pecjax.COORDINATE_SET_1
    wrap = curriculum_wrap(
        pec(20), table, reset_to=ContinuousRooms.reset_to, failed=failed, callback=told.append, every=every
    )
    _, _, seen = ppo.train(ContinuousRooms(rooms), wrap_env_fn=wrap, **SIZES | LEARNING | OTHERS | changes)
    jax.effects_barrier()
    print("goal ratio, of configurations drawn uniformly:", seen["eval/episode_goal"])
    print("trials and failures of each configuration:", told[-1].statistics, sep="\n")
    return told


if __name__ == "__main__":
    use_all_cores()
    keep_compiled_programs()
    main()
