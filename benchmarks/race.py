"""The race: seconds from the command to a policy that flies, ours beside its peers at their best.

    pip install -e '.[peers]'
    python benchmarks/race.py [--racers pecjax brax ...] [--spaces 1 2 rooms-pairs] [--seeds 3] [--limit 300]
        [--best race_best.json] [--out race.json] [--pythons brax=OTHER/bin/python]

First every racer is searched: each of `SEARCH`, for Ape-X `SEARCH_OF_APEX`, once, on set 1 with seed 100.
What reaches 0.97 in the fewest seconds of training is its best. `--best` keeps them; what is there is not
searched again. Then the best race on fresh seeds, one process a run, the racers in turn, so that a machine
that drifts drifts for all. The racer `told` is ours with `--task.critic-paths`.

`--pythons` names the Python of a racer that needs an environment of its own: Brax 0.14.2 does not train on
JAX 0.12.

Every 131,072 steps the policy flies 2,000 greedy episodes, a uniform draw of the configurations; that time
is apart. What is counted are the seconds since the process was started, and the seconds of training: those of
all stretches, where the first, which compiles, counts as much as the median of the others.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

BASE: dict[str, Any] = {
    "num_envs": 512, "num_steps": 32, "num_epochs": 4, "num_minibatches": 8,
    "learning_rate": 1e-3, "entropy_coeff": 0.01, "discount": 0.99, "hidden": [64, 64],
}  # fmt: skip
SEARCH: tuple[dict[str, Any], ...] = (
    {},
    {"learning_rate": 6e-4},
    {"learning_rate": 2e-3},
    {"discount": 0.995},
    {"num_minibatches": 16},
    {"num_epochs": 2, "num_minibatches": 16},
    {"num_epochs": 2, "num_minibatches": 32, "discount": 0.995},
    {"num_envs": 1024, "num_steps": 16},
)
# Ape-X starts from its preset.
SEARCH_OF_APEX: tuple[dict[str, Any], ...] = (
    {},
    {"learning_rate": 1e-4},
    {"learning_rate": 4e-4},
    {"replay_ratio": 1.0},
    {"replay_ratio": 4.0},
    {"n_step": 5},
    {"num_envs": 1024},
    {"batch_size": 512},
)
# C MuJoCo flies few environments at its best; its batches are as large.
OF_SB3 = {512: (64, 256), 1024: (32, 512)}
THRESHOLDS = {"1": (0.95, 0.97), "2": (0.95, 0.97), "rooms-pairs": (0.85, 0.90)}
NAMES = ("pecjax", "told", "apex", "brax", "purejax", "rejax", "sb3")  # of `racers.RACERS`
EPISODES, SEARCH_SEED, FIRST_SEED = 2000, 100, 0


def run(name: str, space: str, seed: int, settings: dict[str, Any], limit: float, started: float) -> dict:
    """One run in this process, to the last threshold or the limit, in seconds of training."""
    import jax
    import numpy as np
    from racers import RACERS

    from pecjax.agents import device_mesh
    from pecjax.envs.rooms import Rooms
    from pecjax.runtime.devices import use_all_cores
    from pecjax.training.build import everywhere, on_devices
    from pecjax.training.evaluation import make_evaluator

    use_all_cores()
    rooms = Rooms(table=space) if space in ("1", "2") else Rooms(space=space)
    task, world = rooms.make()
    mesh = device_mesh(len(jax.devices()))
    _, world = on_devices(world, rooms.eval_set(world), mesh)
    act, training = RACERS[name](settings, rooms, seed)
    agent: Any = SimpleNamespace(
        policy=lambda params, greedy: lambda obs, key: act(params, obs, key), first_memory=None
    )
    evaluator = make_evaluator(task, agent, mesh, episodes=EPISODES, greedy=True, seed=2022)
    stretches: list[float] = []
    reached: dict[str, dict] = {}
    apart, evaluate, ratio = 0.0, None, 0.0
    while len(reached) < len(THRESHOLDS[space]):
        begun = time.perf_counter()
        steps, params = next(training)
        stretches.append(time.perf_counter() - begun)
        begun = time.perf_counter()
        if evaluate is None:
            evaluate = evaluator(everywhere(params, mesh), world)
        ratio = float(np.mean(evaluate(everywhere(params, mesh), world).success))
        apart += time.perf_counter() - begun
        usual = statistics.median(stretches[1:] or stretches)
        seconds = sum(stretches[1:]) + min(usual, stretches[0])
        for threshold in THRESHOLDS[space]:
            if ratio >= threshold and str(threshold) not in reached:
                whole = time.time() - started - apart
                reached[str(threshold)] = {"steps": steps, "training": seconds, "whole": whole}
        if seconds > limit:
            break
    return {"reached": reached, "steps": steps, "training": seconds, "last": ratio}


def in_process(
    name: str, space: str, seed: int, settings: dict[str, Any], limit: float, python: str = sys.executable
) -> dict:
    """The same in a process of its own, with nothing compiled before."""
    asked = {"name": name, "space": space, "seed": seed, "settings": settings, "limit": limit}
    command = [python, __file__, "--one", json.dumps(asked | {"started": time.time()})]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{name} failed with {settings}:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def settings_of(name: str, change: dict[str, Any]) -> dict[str, Any]:
    """A racer's settings: the base with a change; of Ape-X what changes of its preset."""
    if name == "apex":
        return change
    settings = BASE | change
    if name == "sb3":
        settings["num_envs"], settings["num_steps"] = OF_SB3[settings["num_envs"]]
    return settings


def search(name: str, limit: float, python: str) -> dict[str, Any]:
    """The best settings of a racer, and what each of those tried took."""
    tried = []
    for change in SEARCH_OF_APEX if name == "apex" else SEARCH:
        result = in_process(name, "1", SEARCH_SEED, settings_of(name, change), limit, python)
        tried.append({"change": change, **result})
        print(
            f"{name:10} {json.dumps(change):45} {_to_goal(result):8.1f} s, last {result['last']:.3f}",
            flush=True,
        )
    best = min(tried, key=_to_goal)
    return {"settings": settings_of(name, best["change"]), "tried": tried}


def _to_goal(result: dict) -> float:
    """Seconds of training to 0.97; infinite where it was not reached."""
    return result["reached"].get("0.97", {}).get("training", float("inf"))


def main() -> None:
    """Searches, races, prints the table, writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--racers", nargs="*", choices=NAMES, default=[*NAMES])
    parser.add_argument("--spaces", nargs="*", choices=[*THRESHOLDS], default=[*THRESHOLDS])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--limit", type=float, default=300, help="seconds of training of one run")
    parser.add_argument("--best", type=Path, default=Path("race_best.json"))
    parser.add_argument("--out", type=Path, default=Path("race.json"))
    parser.add_argument("--pythons", nargs="*", default=[], help="RACER=PYTHON ...")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        print(json.dumps(run(**json.loads(args.one))))
        return
    pythons = dict.fromkeys(args.racers, sys.executable) | dict(one.split("=", 1) for one in args.pythons)
    best = json.loads(args.best.read_text()) if args.best.exists() else {}
    for name in args.racers:
        if name not in best:
            best[name] = search(name, args.limit, pythons[name])
            args.best.write_text(json.dumps(best, indent=2) + "\n")
    rows = []
    for space in args.spaces:
        for seed in range(FIRST_SEED, FIRST_SEED + args.seeds):
            for name in args.racers:
                settings = best[name]["settings"]
                found = in_process(name, space, seed, settings, args.limit, pythons[name])
                rows.append({"racer": name, "space": space, "seed": seed, **found})
                args.out.write_text(json.dumps(rows, indent=2) + "\n")
        for threshold in map(str, THRESHOLDS[space]):
            print(f"\n{space} to {threshold}: median seconds of training, with all since the start, steps")
            for name in args.racers:
                of = [r["reached"].get(threshold) for r in rows if (r["racer"], r["space"]) == (name, space)]
                figures = [
                    statistics.median(one[kind] if one else float("inf") for one in of)
                    for kind in ("training", "whole", "steps")
                ]
                told = "{:8.1f} {:8.1f} {:12,.0f}".format(*figures)
                print(f"  {name:10} {told}   {sum(map(bool, of))} of {len(of)} reached it", flush=True)


if __name__ == "__main__":
    main()
