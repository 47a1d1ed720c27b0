"""Brax's PPO on Brax's reacher, an arm of two joints, with PEC choosing the target of each episode.

    python examples/brax_reacher.py

Between the two rules is all that the curriculum takes: twelve targets, how an episode begins with one,
what a failure is, and one argument of `ppo.train`. Brax's evaluation draws the targets uniformly.

It needs a JAX before 0.10: Brax 0.14.2's PPO calls a function that newer ones do not have (Brax's issue 671).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax import envs
from brax.training.agents.ppo import train as ppo

from pecjax.curriculum import pec
from pecjax.curriculum.wrappers.brax import curriculum_wrap
from pecjax.runtime.devices import use_all_cores

SIZES = {"num_timesteps": 4_000_000, "num_evals": 5, "num_envs": 512, "batch_size": 128, "num_minibatches": 8}
LEARNING = {"unroll_length": 10, "discounting": 0.95, "learning_rate": 1e-3, "reward_scaling": 5.0}
OTHERS = {"episode_length": 100, "normalize_observations": True, "entropy_cost": 1e-3}

# --------------------------------------------------------------------------------------------------------
ANGLE, RADIUS = np.meshgrid(np.arange(6) * np.pi / 3, [0.08, 0.19])
TARGETS = np.stack([RADIUS * np.cos(ANGLE), RADIUS * np.sin(ANGLE)], axis=-1).reshape(12, 2)  # m


def reset_to(env: Any, target: jax.Array, rng: jax.Array) -> envs.State:
    """The first state of an episode with this target, (2,) m."""
    state = env.reset(rng)
    physics = env.pipeline_init(state.pipeline_state.q.at[2:].set(target), state.pipeline_state.qd)
    return state.replace(pipeline_state=physics, obs=env._get_obs(physics))


def missed(state: envs.State) -> jax.Array:
    """Whether the tip is more than 2 cm from the target, (B,); the last three observations lead there."""
    return jnp.linalg.norm(state.obs[:, -3:], axis=-1) > 0.02


# --------------------------------------------------------------------------------------------------------


def main(every: int = 100, **changes: Any) -> list[Any]:
    """Trains, prints the share of misses at each target, and returns the sampler's states so far."""
    states: list[Any] = []
    wrap = curriculum_wrap(
        pec(12), TARGETS, reset_to=reset_to, failed=missed, callback=states.append, every=every
    )
    settings = SIZES | LEARNING | OTHERS | changes
    env = envs.get_environment("reacher", backend="spring")
    ppo.train(env, wrap_env_fn=wrap, progress_fn=report, **settings)
    jax.effects_barrier()
    trials, failures = states[-1].statistics
    print("trials:", trials, "\nmissed:", np.round(failures / np.maximum(trials, 1), 2))
    return states


def report(steps: int, metrics: dict[str, Any]) -> None:
    """Prints what Brax's evaluation returned."""
    print(steps, "steps, return", metrics.get("eval/episode_reward"))


if __name__ == "__main__":
    use_all_cores()
    main()
