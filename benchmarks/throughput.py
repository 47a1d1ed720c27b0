"""How fast each part is, beside C MuJoCo on the same cores, in one run.

    python benchmarks/throughput.py [--repeats 7] [--out throughput.json] [--only GROUP ...]

Every figure is a median of repeats taken in turn with the others of its group, so that a machine
that drifts drifts for all of them; only ratios within a group are worth quoting.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import learning
import numpy as np
import trainings
import workloads as w
from workloads import Workload

import pecjax
from pecjax import curriculum as c
from pecjax.agents import PPO, Apex
from pecjax.curriculum import pec, uniform
from pecjax.envs.rooms import Rooms, RoomsTask
from pecjax.envs.rooms.plans import FAMILIES, make_plans
from pecjax.envs.task import World
from pecjax.runtime.devices import use_all_cores
from pecjax.runtime.provenance import environment_facts
from pecjax.training.kinds import sampler_label
from pecjax.training.presets import PRESETS

Group = dict[str, Workload]
SECONDS_A_TURN = 0.25  # at least, so that the clock and a busy neighbour matter little


def measure(group: Group, repeats: int) -> dict[str, float]:
    """Median seconds of one call of each, all taken in turn after a warm-up."""
    calls = {}
    for name, workload in group.items():
        workload.run()
        started = time.perf_counter()
        workload.run()
        calls[name] = max(1, round(SECONDS_A_TURN / (time.perf_counter() - started)))
    seconds: dict[str, list[float]] = {name: [] for name in group}
    for _ in range(repeats):
        for name, workload in group.items():
            started = time.perf_counter()
            for _ in range(calls[name]):
                workload.run()
            seconds[name].append((time.perf_counter() - started) / calls[name])
    return {name: statistics.median(times) for name, times in seconds.items()}


def training_parts() -> Group:
    """Control steps: C MuJoCo's physics first, which all others are held against."""
    scene, settings = pecjax.load_scene(), PPO()
    (task, world), mesh = Rooms().make(), w.device_mesh()
    sampler = pec(world.table.size)
    batch = (settings.num_envs, settings.num_steps)
    policy, update = learning.learner(task, mesh, settings)
    return {
        "C MuJoCo rollout, physics alone": w.c_physics(scene, *batch),
        "controller, physics, wall distance": w.flight(scene, mesh, *batch),
        "environment alone": w.environment(task, world, sampler, mesh, *batch),
        "policy step": policy,
        "PPO update": update,
        "PPO training end to end": learning.training(task, world, sampler, mesh, settings),
    }


def environment_counts() -> Group:
    """Training end to end, by how many environments share a batch of one size."""
    (task, world), mesh = Rooms().make(), w.device_mesh()
    sampler = pec(world.table.size)
    return {
        f"training, {num_envs} environments": learning.training(
            task, world, sampler, mesh, PPO(num_envs=num_envs, num_steps=16384 // num_envs)
        )
        for num_envs in (512, 256, 1024, 2048)
    }


def depth_images(resolution: tuple[int, int]) -> Group:
    """Rays: `mj_multiRay` first, which the others are held against."""
    scene, mesh = pecjax.load_scene(resolution=resolution), w.device_mesh()
    num_images = 98304 * 4 // (resolution[0] * resolution[1])
    return {
        "mj_multiRay, all cores": w.c_depth(scene, num_images),
        "ours": w.depth(scene, mesh, num_images),
        "mjx.ray": w.mjx_depth(scene, mesh, num_images),
    }


def devices() -> Group:
    """Training end to end on one device and on all."""
    task, world = Rooms().make()
    sampler = pec(world.table.size)
    return {
        f"training, {number} device(s)": learning.training(task, world, sampler, w.device_mesh(number), PPO())
        for number in (1, len(jax.devices()))
    }


def maps() -> Group:
    """Our environment in one map, in many copies of it, in floor plans, and in plans of 64 boxes each.

    There are 2,000 configurations each.
    """
    (task, world), mesh, settings = Rooms().make(), w.device_mesh(), PPO()
    rows = np.arange(2000)
    table = jax.tree.map(lambda leaf: np.asarray(leaf)[rows % len(leaf)], world.table)
    group: Group = {}
    for number in (1, 2000):
        bank = jax.tree.map(lambda leaf, number=number: np.repeat(leaf, number, axis=0), world.params.bank)
        there = World(
            world.params._replace(bank=bank), table.replace(map_id=(rows % number).astype(np.int32))
        )
        group[f"environment alone, {number:,} map(s)"] = w.environment(
            task, there, uniform(2000), mesh, settings.num_envs, settings.num_steps
        )
    apartment = next(family for family in FAMILIES if family.name == "apartment")
    crowded = dataclasses.replace(apartment, low=(20, 20), shelves=(20, 20), hanging=(20, 20))
    for name, families in {"floor plans": FAMILIES, "crowded floor plans": (crowded,)}.items():
        plans = make_plans(1000, families=families, workers=2)
        group[f"environment alone, 1,000 {name}"] = w.environment(
            RoomsTask(task.vehicle),  # its own, as programs are kept by task
            World(world.params._replace(bank=plans.bank), plans.configurations),
            uniform(2000),
            mesh,
            settings.num_envs,
            settings.num_steps,
        )
    return group


def samplers() -> Group:
    """Training end to end under uniform sampling and under PEC, and each sampler's own part of it."""
    (task, world), mesh = Rooms().make(), w.device_mesh()
    size = world.table.size
    both = {"uniform": uniform(size), "PEC": pec(size)}
    whole = {f"training, {k}": learning.training(task, world, s, mesh, PPO()) for k, s in both.items()}
    parts = {f"{k} alone": learning.sampling(s, size, mesh, PPO()) for k, s in both.items()}
    return whole | parts


FAMILY = (
    c.Uniform(), c.PEC(), c.Forgetting(), c.FailureEMA(), c.Learnability(), c.PassAtN(), c.TableTop(),
    c.Thompson(), c.LearningProgress(), c.DRO(), c.PLR(rank=False), c.PLR(rank=False, score="max_mc"),
    c.SFL(), c.Floor(), c.Mixture(), c.PerStep(),
)  # fmt: skip


def large_curricula() -> Group:
    """Draws and their tally, and a copy of the counts, by the number of configurations and by sampler."""
    group: Group = {}
    for num_configs in (20, 10_000, 1_000_000):
        work, copy = learning.curriculum(pec(num_configs), num_configs, 4096)
        group[f"copy of the counts, N = {num_configs:,}"] = copy
        group[f"draw and tally 4,096, N = {num_configs:,}"] = work
    million = 1_000_000
    for kind in FAMILY:
        work, _ = learning.curriculum(kind.make(million), million, 16_384)
        group[f"draw and tally 16,384, N = {million:,}, {sampler_label(kind)}"] = work
    return group


def apex_training() -> Group:
    """Ape-X end to end, against C MuJoCo's physics and PPO."""
    (task, world), mesh = Rooms().make(), w.device_mesh()
    sampler, settings, scene = pec(world.table.size), Apex(), pecjax.load_scene()
    return {
        "C MuJoCo rollout, physics alone": w.c_physics(scene, settings.num_envs, settings.num_steps),
        "PPO training end to end": learning.training(task, world, sampler, mesh, PPO()),
        "Ape-X training end to end": learning.training(task, world, sampler, mesh, settings),
    }


def replay_growth() -> Group:
    """One shard's replay by its size; the smaller one's row comes first."""
    small, large = learning.replay_parts(2**17), learning.replay_parts(2**20)
    group: Group = {}
    for name in small:
        group |= {f"{name} of 2^17": small[name], f"{name} of 2^20": large[name]}
    return group


def studies() -> Group:
    """One training, and studies of several α in batches of so many runs."""
    task, world = Rooms().make()
    sampler = pec(world.table.size)
    group = {"training, one run": learning.training(task, world, sampler, w.device_mesh(), PPO())}
    for number, parallel_runs in ((2, 2), (5, 2), (4, 4)):
        alphas = tuple(0.1 * k for k in range(number))
        group[f"study of {number} α, {parallel_runs} runs at once"] = trainings.study(alphas, parallel_runs)
    return group


def checkpoints() -> Group:
    """The iterations from one checkpoint to the next, and the checkpoint."""
    group: Group = {}
    for name in ("fast", "apex-fast"):
        interval, checkpoint = trainings.checkpointing(PRESETS[name])
        group |= {f"{name}: an interval's iterations": interval, f"{name}: its checkpoint": checkpoint}
    return group


GROUPS: dict[str, Callable[[], Group]] = {
    "training": training_parts,
    "environments": environment_counts,
    "depth-16x12": lambda: depth_images((16, 12)),
    "depth-64x48": lambda: depth_images((64, 48)),
    "devices": devices,
    "maps": maps,
    "samplers": samplers,
    "curricula": large_curricula,
    "apex": apex_training,
    "replay": replay_growth,
    "studies": studies,
    "checkpoints": checkpoints,
}


def peak_memory(pid: int) -> float:
    """GB that a running process has held at most.

    Not `wait4`'s figure: a child's begins with what its parent held when it was started.
    """
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")) / 1e6


def startup() -> dict[str, float]:
    """Seconds from `pecjax train` to its first progress line, and its peak memory in GB."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        surroundings = os.environ | {"XDG_CACHE_HOME": folder}
        for state in ("cold", "warm"):
            command = [sys.executable, "-m", "pecjax.cli", "train", "--iterations", "60"]
            command += ["--out", str(Path(folder) / state)]
            started = time.perf_counter()
            with subprocess.Popen(
                command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=surroundings
            ) as run:
                assert run.stderr is not None
                for line in run.stderr:
                    if line.startswith("iteration 1/"):
                        found[f"first progress line, {state} cache"] = time.perf_counter() - started
                    found[f"peak memory of training, {state} cache"] = peak_memory(run.pid)
    return found


def main() -> None:
    """Runs the groups, prints the tables, writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("throughput.json"))
    parser.add_argument("--only", nargs="*", default=[*GROUPS, "startup"], choices=[*GROUPS, "startup"])
    args = parser.parse_args()
    use_all_cores()
    results: dict[str, object] = {}
    for name in args.only:
        print(f"\n{name}")
        if name == "startup":
            results[name] = startup()
            for what, figure in results[name].items():
                print(f"  {what:40} {figure:8.2f} {'GB' if 'memory' in what else 's'}")
            continue
        group = GROUPS[name]()
        seconds = measure(group, args.repeats)
        rates = {case: work.amount / seconds[case] for case, work in group.items()}
        first = next(iter(rates.values()))
        for case, rate in rates.items():
            shown = f"{rate:,.0f}" if rate >= 100 else f"{rate:.3g}"
            print(f"  {case:40} {shown:>14} {group[case].unit:16} {rate / first:8.3f} ×")
        results[name] = {case: {"rate": rate, "ratio": rate / first} for case, rate in rates.items()}
    facts = environment_facts(len(jax.devices()))
    args.out.write_text(json.dumps({"results": results} | facts, indent=2) + "\n")


if __name__ == "__main__":
    main()
