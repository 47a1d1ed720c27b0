"""Flies an exported policy in C MuJoCo, the network by onnxruntime, without JAX or pecjax.

    pecjax export runs/a
    python examples/fly_exported.py runs/a 500

Starts and goals are the run's configurations, all equally often; headings are random. `pecjax eval runs/a
--episodes 500` does the same in MJX.
"""

import sys

import numpy as np
from exported_policy import ExportedPolicy, heading, towards
from mujoco_rooms import Simulation


def reaches_goal(policy, simulation, start, goal, looking):
    """Flies one episode from (x, y) to (x, y); returns whether it reached its goal."""
    control, place = policy.about["control"], simulation.data.qpos
    simulation.place([*start, control["flight_height_m"]], looking)
    policy.begin()
    for _ in range(control["max_steps"]):
        command = policy.act(simulation.depth(), *towards(goal, place[:2], heading(place[3:7])))
        if simulation.step(*command):
            return False
        if towards(goal, place[:2], 0.0)[0] < control["goal_radius_m"]:
            return True
    return False


def wilson(successes, episodes, z=1.959964):
    """The 95 % interval of a ratio."""
    ratio, more = successes / episodes, z * z / episodes
    middle, half = ratio + more / 2, np.sqrt(ratio * (1 - ratio) * more + more * more / 4)
    return (middle - half) / (1 + more), (middle + half) / (1 + more)


def main(folder, episodes=100, seed=0):
    """Prints and returns how many of the episodes reach their goal."""
    policy = ExportedPolicy(f"{folder}/policy.onnx")
    simulation = Simulation(f"{folder}/scene.xml", policy.about)
    table, draw = np.loadtxt(f"{folder}/coordinates.csv", delimiter=",", ndmin=2), np.random.default_rng(seed)
    if table.shape[1] != 4:
        raise ValueError("the configurations have more than start and goal, which this example does not fly")
    rest = draw.permutation(len(table))[: episodes % len(table)]
    rows = np.concatenate([np.tile(np.arange(len(table)), episodes // len(table)), rest])
    reached = [
        reaches_goal(policy, simulation, row[:2], row[2:], draw.uniform(-np.pi, np.pi)) for row in table[rows]
    ]
    low, high = wilson(sum(reached), episodes)
    print(f"reached the goal in {sum(reached)} of {episodes} episodes, 95 % [{low:.3f}, {high:.3f}]")
    return sum(reached)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
