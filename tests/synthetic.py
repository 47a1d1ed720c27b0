"""Studies that nobody trained: the files that a study would leave, from goal ratios that a test chooses."""

from dataclasses import replace

import numpy as np

from pecjax.agents import Metrics
from pecjax.envs.task import EvalSet
from pecjax.studies.catalogue import find_study
from pecjax.studies.collect import Collected
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import StudySettings
from pecjax.training.rows import configuration_arrays, episode_arrays, evaluation_row, metrics_row
from pecjax.training.run_episodes import EvalResult
from pecjax.training.settings import override

BATCH = 16_384  # environment steps an iteration
EVALUATIONS, EVERY = 8, 5  # iterations between evaluations
EPISODES = 10  # of each configuration, a training iteration and an evaluation
LENGTH = 80  # steps of each


def study_settings(alphas=(0.2,), seeds=(0, 1, 2), coordinates=("1",), samplers=("pec", "uniform")):
    run = override(find_study("fig4", "smoke").run, iterations=EVALUATIONS * EVERY, evaluate_every=EVERY)
    grid = {"task.table": coordinates, "sampler": samplers, "sampler.alpha": alphas}
    return StudySettings("made up", run, tuple(grid.items()), seeds, parallel_runs=1)


def write_study(folder, settings, ratio, scene=None):
    """Writes a finished study.

    Args:
        ratio: (settings of the run, progress in (0, 1]) -> the goal ratio that it has by then.
        scene: the path of a map, for another than the shipped one.
    """
    if scene is not None:
        settings = replace(settings, run=override(settings.run, scene=(str(scene),)))
    directory = StudyDirectory(folder)
    batches = settings.batches()
    tasks = dict.fromkeys(settings.settings_of(spec).task for (spec,) in batches)
    sizes = {task: task.configurations().size for task in tasks}
    with directory.open(settings, [*tasks], 1):
        for number, (spec,) in enumerate(batches):
            of_run = settings.settings_of(spec)
            collected = Collected([settings.row(spec)])
            for iteration in range(1, EVALUATIONS * EVERY + 1):
                value = ratio(of_run, iteration / (EVALUATIONS * EVERY))
                add(collected, iteration, sizes[of_run.task], value)
            directory.write_batch(number, collected)
        directory.merge_tables(len(batches))
    return folder


def add(collected, iteration, size, value):
    """What an iteration of a run leaves, and where it is due the evaluation after it."""
    steps = iteration * BATCH
    collected.rows("metrics", [metrics_row(iteration, steps, made_metrics(value))])
    if iteration % EVERY == 0:
        counts = made_counts(size, value) * iteration
        flights = made_flights(size, value)
        collected.arrays("configurations", iteration, [configuration_arrays(counts, np.full(size, 1 / size))])
        collected.rows("evaluation", [evaluation_row(iteration, steps, flights, EvalSet(np.zeros(size)))])
        collected.arrays("episodes", iteration, [episode_arrays(flights)])


def made_counts(size, ratio):
    trials = np.full(size, EPISODES)
    failures = np.round(trials * (1 - ratio) * np.linspace(0.5, 1.5, size)).clip(0, EPISODES)
    return np.stack([trials, failures, trials * LENGTH]).astype(int)


def made_metrics(ratio):
    failed = round(1000 * (1 - ratio))
    return Metrics(
        np.array(1000),
        np.array([1000, failed]),
        {"return": np.array(100.0), "length": np.array(9.0)},
        {},
        {},
        {},
    )


def made_flights(size, ratio):
    config_id = np.repeat(np.arange(size), EPISODES)
    success = np.arange(config_id.size) % EPISODES < round(EPISODES * ratio)
    return EvalResult(config_id, success, 2000.0 * success, np.full(success.shape, 3), {})
