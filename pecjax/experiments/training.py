"""Training: the host's loop around an agent's iterations."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pecjax.agents import ppo
from pecjax.agents.agent import AXIS, Agent, Metrics, fleet_mesh, shard
from pecjax.experiments import evaluation
from pecjax.experiments.checkpoint import Checkpoints
from pecjax.experiments.devices import choose_num_devices
from pecjax.experiments.presets import SAMPLERS, RunSettings, check_settings
from pecjax.experiments.progress import RunProgress
from pecjax.experiments.run_directory import RunDirectory, check_free
from pecjax.world.coordinates import Configurations, check_coordinates, load_coordinates
from pecjax.world.navigation import RoomsNavigation
from pecjax.world.scene import Scene, default_scene_path, load_scene

DRAWN_FLIGHTS = 2  # of each configuration, kept in trajectories.csv


class Run(NamedTuple):
    """What a run is built from."""

    env: RoomsNavigation
    table: Configurations
    agent: Agent
    mesh: Mesh


def build(settings: RunSettings, scene: Scene, table: Configurations, num_devices: int) -> Run:
    """Puts world, curriculum and learner together, spread over devices.

    Raises:
        InputError: the coordinates cannot be flown in the scene, or settings that do not fit.
    """
    env = RoomsNavigation(scene, table)
    check_coordinates(
        scene, table, flight_height=env.settings.flight_height, goal_radius=env.settings.goal_radius
    )
    sampler = SAMPLERS[settings.sampler](table.size, settings.alpha)
    mesh = fleet_mesh(num_devices)
    return Run(env, table, shard(ppo.make(env, table, sampler, settings.ppo, AXIS), mesh), mesh)


def abstract_learner(run: Run) -> Any:
    """Shapes and placement of the learner's arrays, without making any of them."""
    everywhere = NamedSharding(run.mesh, PartitionSpec())
    state = jax.eval_shape(run.agent.init, jax.random.key(0))
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=everywhere), state.learner)


def compile_evaluator(run: Run, settings: RunSettings, learner: Any):
    """The run's evaluation as a compiled program, learner -> flights."""
    return evaluation.make_evaluator(
        run.env,
        run.table,
        run.agent,
        run.mesh,
        episodes=settings.evaluation_episodes,
        greedy=settings.greedy,
        seed=settings.evaluation_seed,
    )(learner)


def train(settings: RunSettings, folder: Path, devices: int | None = None) -> dict[str, Any]:
    """Trains from scratch and writes the run directory.

    Args:
        folder: where to; must be empty or not there.
        devices: how many share the environments, all that divide them when None.

    Returns:
        the content of summary.json.

    Raises:
        InputError: anything the user can put right; nothing has been written then.
    """
    check_settings(settings)
    scene_path = Path(settings.scene) if settings.scene else default_scene_path()
    table = load_coordinates(settings.coordinates)
    num_devices = choose_num_devices(devices, settings.ppo.num_envs)
    build(settings, load_scene(scene_path, settings.resolution), table, num_devices)
    check_free(folder)
    directory = RunDirectory(folder)
    directory.create(settings, scene_path, table, num_devices)
    run = build(settings, load_scene(directory.scene_path, settings.resolution), table, num_devices)
    with RunProgress(settings.iterations) as progress:
        progress.say(f"{folder}: {settings.ppo.num_envs} environments on {num_devices} device(s)")
        return _loop(settings, run, directory, progress)


def _loop(
    settings: RunSettings, run: Run, directory: RunDirectory, progress: RunProgress
) -> dict[str, Any]:
    checkpoints = Checkpoints(directory.folder)
    compiling = time.perf_counter()
    state = run.agent.init(jax.random.key(settings.seed))
    iterate = jax.jit(run.agent.iterate, donate_argnums=0).lower(state).compile()
    evaluate = None
    begun = time.perf_counter()
    compile_seconds = begun - compiling
    progress.say(f"compiled in {compile_seconds:.1f} s")

    counts = np.zeros((2, run.table.size), np.int64)
    probabilities = jax.jit(_sampler(settings, run).probabilities)
    flights = None
    for iteration in range(1, settings.iterations + 1):
        state, metrics = iterate(state)
        metrics = jax.device_get(metrics)
        counts += metrics.counts
        seconds = time.perf_counter() - begun
        row = _metrics_row(iteration, run.agent.steps_per_iteration, seconds, metrics)
        directory.append("metrics.csv", [row])
        last = iteration == settings.iterations
        if iteration == 1 or iteration % settings.configurations_every == 0 or last:
            current = np.asarray(probabilities(state.sampler))
            directory.append("configurations.csv", _configuration_rows(iteration, counts, current))
        if iteration % settings.evaluate_every == 0 or last:
            checkpoints.save(iteration, state)
            if evaluate is None:
                paused = time.perf_counter()
                evaluate = compile_evaluator(run, settings, state.learner)
                begun += time.perf_counter() - paused
                compile_seconds += time.perf_counter() - paused
            flights = evaluate(state.learner)
            evaluated = _evaluation_row(iteration, row["env_steps"], flights, run.table.size)
            directory.append("evaluation.csv", [evaluated])
            progress.say(
                f"iteration {iteration}: uniform evaluation over {settings.evaluation_episodes} "
                f"{'greedy' if settings.greedy else 'sampled'} episodes, "
                f"goal ratio {evaluated['goal_ratio']:.3f}"
            )
        rate = row["env_steps"] / seconds
        left = (settings.iterations - iteration) * seconds / iteration
        progress.advance(iteration, row["goal_ratio"], rate, left)

    directory.append("trajectories.csv", _path_rows(flights, run.table.size))
    summary = {
        "iterations": settings.iterations,
        "env_steps": row["env_steps"],
        "seconds": round(time.perf_counter() - begun, 2),
        "compile_seconds": round(compile_seconds, 2),
        "steps_per_second": round(rate, 1),
        "training_goal_ratio": float(row["goal_ratio"]),
        "uniform_evaluation": {
            "episodes": settings.evaluation_episodes,
            "greedy": settings.greedy,
            "goal_ratio": float(evaluated["goal_ratio"]),
            "mean_return": float(evaluated["mean_return"]),
        },
    }
    directory.write_json("summary.json", summary)
    return summary


def _sampler(settings: RunSettings, run: Run):
    return SAMPLERS[settings.sampler](run.table.size, settings.alpha)


def _metrics_row(iteration: int, batch: int, seconds: float, metrics: Metrics) -> dict[str, Any]:
    trials, failures = metrics.counts.sum(axis=1)

    def mean(total: float) -> float:
        return float(total) / trials if trials else float("nan")

    return {
        "iteration": iteration,
        "env_steps": iteration * batch,
        "seconds": round(seconds, 3),
        "goal_ratio": mean(trials - failures),
        "episodes": int(trials),
        "mean_return": mean(metrics.return_sum),
        "mean_length": mean(metrics.length_sum),
    } | {name: float(value) for name, value in metrics.losses.items()}


def _configuration_rows(iteration: int, counts: np.ndarray, probabilities: np.ndarray):
    for config, (trials, failures) in enumerate(counts.T):
        yield {
            "iteration": iteration,
            "config": config,
            "trials": trials,
            "failures": failures,
            "probability": probabilities[config],
        }


def _evaluation_row(
    iteration: int, env_steps: int, flights: evaluation.Flights, num_configs: int
) -> dict[str, Any]:
    ratios = evaluation.goal_ratios(flights, num_configs)
    return {
        "iteration": iteration,
        "env_steps": env_steps,
        "goal_ratio": flights.goal.mean(),
        "mean_return": flights.returns.mean(),
    } | {f"c{config}": ratio for config, ratio in enumerate(ratios)}


def _path_rows(flights: evaluation.Flights, num_configs: int):
    for config in range(num_configs):
        for episode in np.flatnonzero(flights.config_id == config)[:DRAWN_FLIGHTS]:
            path = flights.paths[episode, : flights.lengths[episode] + 1]
            for step, (x, y) in enumerate(path):
                yield {
                    "episode": episode,
                    "config": config,
                    "goal": int(flights.goal[episode]),
                    "step": step,
                    "x": x,
                    "y": y,
                }
