"""Control steps per second: C MuJoCo's physics alone, our environment, and training end to end.

    python benchmarks/throughput.py [--repeats 7] [--out throughput.json]

All figures are medians of repeats taken in turn within one run, so that a machine that drifts
drifts for all of them; only the ratios are worth quoting.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.sharding import PartitionSpec
from mujoco import rollout as c_rollout

import pecjax
from pecjax.agents import AXIS, fleet_mesh, ppo, shard
from pecjax.agents.rollout import env_keys, launch, rollout
from pecjax.curriculum import pec
from pecjax.experiments.devices import use_all_cores
from pecjax.experiments.run_directory import environment_facts

NUM_ENVS, NUM_STEPS = 512, 32  # of one batch, as in the preset `fast`

# A prepared workload: each call does one batch of NUM_ENVS × NUM_STEPS control steps.
Work = Callable[[], None]


def c_physics(env: pecjax.RoomsNavigation) -> Work:
    """C MuJoCo's `rollout` on every core: the same model and physics steps, and nothing else."""
    model = env.scene.model
    cores = len(os.sched_getaffinity(0))
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    initial = np.tile(state, (NUM_ENVS, 1))
    hover = env.scene.mass * 9.81 / model.nu
    controls = np.random.default_rng(0).uniform(
        0.9 * hover, 1.1 * hover, (NUM_ENVS, NUM_STEPS * env.physics_steps, model.nu)
    )
    pool = c_rollout.Rollout(nthread=cores)
    threads = [mujoco.MjData(model) for _ in range(cores)]
    return lambda: pool.rollout(model, threads, initial, controls)


def environment(env: pecjax.RoomsNavigation, num_devices: int) -> Work:
    """Our environment under random actions: flight, depth, reward, endings, resets, PEC."""
    table = env.configurations
    sampler = pec(table.size)
    mesh = fleet_mesh(num_devices)
    spread, same = PartitionSpec(AXIS), PartitionSpec()

    def random_actions(obs, keys):
        return jax.vmap(lambda key: jax.random.randint(key, (), 0, env.action_size))(keys), ()

    def batch(fleet, sampler_state, key):
        num_local = fleet.config_id.shape[0]
        ids = jax.lax.axis_index(AXIS) * num_local + jnp.arange(num_local)
        fleet, trajectory, episodes = rollout(
            env, table, sampler, sampler_state, random_actions, fleet, key, ids, NUM_STEPS
        )
        # A sum over every image, so that none is optimised away.
        seen = jax.lax.psum(trajectory.obs["depth"].sum() + trajectory.reward.sum(), AXIS)
        return fleet, sampler.update(sampler_state, episodes.outcomes, AXIS), seen

    program = jax.jit(
        jax.shard_map(
            batch, mesh=mesh, in_specs=(spread, same, same), out_specs=(spread, same, same), check_vma=False
        )
    )
    key = jax.random.key(0)
    state = sampler.init()
    fleet = jax.device_put(
        jax.jit(partial(launch, env, table, sampler, num_envs=NUM_ENVS))(sampler_state=state, key=key),
        jax.NamedSharding(mesh, spread),
    )
    carry = [fleet, state, 0]

    def work() -> None:
        carry[2] += 1
        fleet, state, seen = program(carry[0], carry[1], env_keys(key, jnp.array([carry[2]]))[0])
        carry[:2] = fleet, state
        jax.block_until_ready(seen)

    return work


def training(env: pecjax.RoomsNavigation, num_devices: int) -> Work:
    """PPO end to end, preset `fast`, PEC."""
    table = env.configurations
    settings = ppo.PPOSettings(num_envs=NUM_ENVS, num_steps=NUM_STEPS)
    agent = shard(ppo.make(env, table, pec(table.size), settings, AXIS), fleet_mesh(num_devices))
    carry = [agent.init(jax.random.key(0))]
    iterate = jax.jit(agent.iterate, donate_argnums=0)

    def work() -> None:
        carry[0], metrics = iterate(carry[0])
        jax.block_until_ready(metrics)

    return work


def measure(cases: dict[str, Work], repeats: int) -> dict[str, float]:
    """Median control steps per second of each, all taken in turn after a warm-up."""
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    for turn in range(repeats + 2):
        for name, work in cases.items():
            begun = time.perf_counter()
            for _ in range(4):
                work()
            if turn >= 2:
                seconds[name].append(time.perf_counter() - begun)
    return {name: 4 * NUM_ENVS * NUM_STEPS / statistics.median(times) for name, times in seconds.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("throughput.json"))
    args = parser.parse_args()
    use_all_cores()
    num_devices = len(jax.devices())
    env = pecjax.RoomsNavigation(pecjax.load_scene())
    reference = "C MuJoCo rollout, physics alone"
    rates = measure(
        {
            reference: c_physics(env),
            "environment alone, random actions": environment(env, num_devices),
            "PPO training end to end": training(env, num_devices),
        },
        args.repeats,
    )
    print(f"{num_devices} devices, {NUM_ENVS} environments, {env.physics_steps} physics steps a control step")
    for name, rate in rates.items():
        print(f"{name:36} {rate:12,.0f} control steps/s {rate / rates[reference]:6.2f} ×")
    rows = {
        name: {"steps_per_second": rate, "ratio": rate / rates[reference]} for name, rate in rates.items()
    }
    args.out.write_text(json.dumps({"rates": rows} | environment_facts(num_devices), indent=2) + "\n")


if __name__ == "__main__":
    main()
