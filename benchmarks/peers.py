"""Training steps per second beside Brax, rejax and Stable-Baselines3, on the same task.

    pip install -e '.[peers]'
    python benchmarks/peers.py [--rounds 5] [--out peers.json] [--only brax rejax sb3]

Same map, drone, physics, 16×12 depth, network (two towers of 64-64 tanh), batch (16,384 steps) and
epochs (4 × 8 minibatches). One call of Brax's training drives the rounds, since it is not to be
interrupted: between its epochs ours and the others take their turns, so that drift cancels.
Stable-Baselines3 flies C MuJoCo with `mj_multiRay` for eyes; its controller is our jitted one.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import learning
import numpy as np
import workloads
from brax.envs.base import Env, State

import pecjax
from pecjax import agents
from pecjax.agents.observations import encode
from pecjax.curriculum import pec
from pecjax.envs.rooms.sensing import scale
from pecjax.envs.rooms.task import SPEEDS, YAW_RATES
from pecjax.envs.task import World
from pecjax.runtime.devices import use_all_cores
from pecjax.runtime.provenance import environment_facts

NUM_ENVS, NUM_STEPS, NUM_EPOCHS, NUM_MINIBATCHES = 512, 32, 4, 8
BATCH = NUM_ENVS * NUM_STEPS
BATCHES_A_TURN = 8

Turn = Callable[[], int]  # trains for a while; returns the environment steps that it took


def flat(env: pecjax.RoomsNavigation, obs: dict[str, jax.Array]) -> jax.Array:
    """An observation as our own networks are given it."""
    return encode(env.task.observation_space, scale(obs, env.scene.vehicle.camera.far))


def snapped(action: jax.Array) -> jax.Array:
    """The action nearest to two numbers from -1 to 1."""
    part = (jnp.clip(action, -1, 1) + 1) / 2 * jnp.array([len(SPEEDS), len(YAW_RATES)])
    speed, turn = jnp.floor(jnp.minimum(part, jnp.array([len(SPEEDS), len(YAW_RATES)]) - 1e-3))
    return (speed * len(YAW_RATES) + turn).astype(jnp.int32)


class BraxRooms(Env):
    """Our environment as Brax's PPO wants it: flat observations, continuous actions snapped."""

    def __init__(self, env: pecjax.RoomsNavigation) -> None:
        self.inner = env

    def _flat(self, state: State) -> State:
        return state.replace(obs=flat(self.inner, state.obs))

    def reset(self, rng: jax.Array) -> State:
        return self._flat(self.inner.reset(rng))

    def step(self, state: State, action: jax.Array) -> State:
        state = self._flat(self.inner.step(state, snapped(action)))
        return state.replace(reward=state.reward * 1e-3)

    @property
    def observation_size(self) -> int:
        return int(np.prod(self.inner.observation_size["depth"])) + 3

    @property
    def action_size(self) -> int:
        return 2

    @property
    def backend(self) -> str:
        return "mjx"


def brax_training(env: pecjax.RoomsNavigation, rounds: int, between: Callable[[], None]) -> list[float]:
    """Steps per second of each round of Brax PPO; calls `between` after each."""
    from brax.training.agents.ppo import networks, train

    rates: list[float] = []
    started = [time.perf_counter()]

    def progress(steps: int, metrics: dict) -> None:
        rates.append(BATCH * BATCHES_A_TURN / (time.perf_counter() - started[0]))
        between()
        started[0] = time.perf_counter()

    train.train(
        environment=BraxRooms(env),
        num_timesteps=BATCH * BATCHES_A_TURN * (rounds + 1),
        num_evals=rounds + 2,
        run_evals=False,
        episode_length=env.task.max_steps,
        num_envs=NUM_ENVS,
        unroll_length=NUM_STEPS,
        batch_size=NUM_ENVS // NUM_MINIBATCHES,
        num_minibatches=NUM_MINIBATCHES,
        num_updates_per_batch=NUM_EPOCHS,
        learning_rate=3e-4,
        discounting=0.99,
        entropy_cost=0.01,
        clipping_epsilon=0.2,
        network_factory=functools.partial(
            networks.make_ppo_networks,
            policy_hidden_layer_sizes=(64, 64),
            value_hidden_layer_sizes=(64, 64),
            activation=jnp.tanh,
        ),
        progress_fn=progress,
    )
    return rates[1:]  # the first holds the compilation


def rejax_training(env: pecjax.RoomsNavigation) -> Turn:
    """rejax's PPO; it knows one device."""
    from gymnax.environments import environment, spaces
    from rejax import PPO

    class GymnaxRooms(environment.Environment):
        """Our environment as gymnax wants it."""

        @property
        def default_params(self):
            return environment.EnvParams(max_steps_in_episode=env.task.max_steps)

        def reset_env(self, key, params):
            state = env.reset(key)
            return flat(env, state.obs), state

        def step_env(self, key, state, action, params):
            state = env.step(state, action)
            return flat(env, state.obs), state, state.reward * 1e-3, state.done.astype(bool), {}

        def observation_space(self, params):
            return spaces.Box(-10, 10, (int(np.prod(env.observation_size["depth"])) + 3,))

        def action_space(self, params):
            return spaces.Discrete(env.action_size)

    algorithm = PPO.create(
        env=GymnaxRooms(),
        agent_kwargs={"activation": "tanh", "hidden_layer_sizes": (64, 64)},
        num_envs=NUM_ENVS,
        num_steps=NUM_STEPS,
        num_epochs=NUM_EPOCHS,
        num_minibatches=NUM_MINIBATCHES,
        learning_rate=3e-4,
        gamma=0.99,
        gae_lambda=0.95,
        total_timesteps=BATCH,
        eval_freq=BATCH,
    )
    iterate = jax.jit(algorithm.train_iteration, donate_argnums=0)
    state = [jax.jit(algorithm.init_state)(jax.random.key(0))]

    def turn() -> int:
        for _ in range(BATCHES_A_TURN):
            state[0] = iterate(state[0])
        jax.block_until_ready(state[0])
        return BATCH * BATCHES_A_TURN

    return turn


def sb3_training(env: pecjax.RoomsNavigation, num_envs: int) -> Turn:
    """Stable-Baselines3's PPO over C MuJoCo, all environments in one process."""
    import torch
    from c_rooms import CRooms
    from stable_baselines3 import PPO

    torch.set_num_threads(workloads.num_cores())
    model = PPO(
        "MlpPolicy",
        CRooms(env, num_envs),
        n_steps=BATCH // num_envs,
        batch_size=BATCH // NUM_MINIBATCHES,
        n_epochs=NUM_EPOCHS,
        learning_rate=3e-4,
        ent_coef=0.01,
        policy_kwargs={"net_arch": {"pi": [64, 64], "vf": [64, 64]}, "activation_fn": torch.nn.Tanh},
        device="cpu",
    )

    def turn() -> int:
        model.learn(BATCH, reset_num_timesteps=False)
        return BATCH

    return turn


def our_training(env: pecjax.RoomsNavigation) -> Turn:
    """Ours, the preset `fast` with PEC, over all devices."""
    settings = agents.PPO(num_envs=NUM_ENVS, num_steps=NUM_STEPS)
    sampler, world = pec(env.configurations.size), World(env.params, env.configurations)
    work = learning.training(env.task, world, sampler, workloads.device_mesh(), settings)

    def turn() -> int:
        for _ in range(BATCHES_A_TURN):
            work.run()
        return BATCH * BATCHES_A_TURN

    return turn


def main() -> None:
    """Takes the turns, prints the table, writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("peers.json"))
    parser.add_argument("--only", nargs="*", default=["brax", "rejax", "sb3"])
    args = parser.parse_args()
    use_all_cores()
    env = pecjax.RoomsNavigation(pecjax.load_scene())
    turns = {"pecjax": our_training(env)}
    if "rejax" in args.only:
        turns["rejax PPO"] = rejax_training(env)
    if "sb3" in args.only:
        for num_envs in (16, 64):
            turns[f"Stable-Baselines3 PPO, C MuJoCo, {num_envs} environments"] = sb3_training(env, num_envs)
    rates: dict[str, list[float]] = {name: [] for name in turns}
    for turn in turns.values():
        turn()  # compiles

    def take_turns() -> None:
        for name, turn in turns.items():
            started = time.perf_counter()
            steps = turn()
            rates[name].append(steps / (time.perf_counter() - started))

    if "brax" in args.only:
        rates["Brax PPO"] = brax_training(env, args.rounds, take_turns)
    else:
        for _ in range(args.rounds):
            take_turns()
    medians = {name: statistics.median(found) for name, found in rates.items()}
    print(f"{len(jax.devices())} devices, {os.cpu_count()} cores")
    for name, rate in medians.items():
        print(f"{name:52} {rate:10,.0f} steps/s   ours is {medians['pecjax'] / rate:6.2f} × as fast")
    rows = {name: {"rate": rate, "ratio": medians["pecjax"] / rate} for name, rate in medians.items()}
    facts = environment_facts(len(jax.devices()))
    args.out.write_text(json.dumps({"results": rows} | facts, indent=2) + "\n")


if __name__ == "__main__":
    main()
