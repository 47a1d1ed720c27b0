"""Studies that nobody trained: the files that a study would leave, from goal ratios that a test chooses."""

from dataclasses import replace

import numpy as np

from pecjax.agents.agent import Metrics
from pecjax.envs.rooms import load_coordinates, load_scene
from pecjax.envs.rooms.scene import default_scene_path
from pecjax.studies.catalogue import find_study
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import StudySettings
from pecjax.studies.run import _Rows
from pecjax.training.evaluation import EvalResult

BATCH = 16_384  # environment steps an iteration
EVALUATIONS, EVERY = 8, 5  # iterations between evaluations
EPISODES = 10  # of each configuration, a training iteration and an evaluation


def study_settings(alphas=(0.2,), seeds=(0, 1, 2), coordinates=("1",), samplers=("pec", "uniform")):
    run = replace(find_study("fig4", "smoke").run, iterations=EVALUATIONS * EVERY, evaluate_every=EVERY)
    return StudySettings("made up", run, samplers, alphas, coordinates, seeds, at_once=1)


def write_study(folder, settings, ratio, scene=None):
    """Writes a finished study.

    Args:
        ratio: (member, progress in (0, 1]) -> the goal ratio that a run has by then.
        scene: the path of a map, for another than the shipped one.
    """
    path = scene or default_scene_path()
    tables = {name: load_coordinates(name) for name in settings.coordinates}
    directory = StudyDirectory(folder)
    slices = settings.slices()
    with directory.open(settings, {name: (path, load_scene(path), tables[name]) for name in tables}, 1):
        for number, (member,) in enumerate(slices):
            rows = _Rows(settings, member, BATCH)
            for iteration in range(1, EVALUATIONS * EVERY + 1):
                value = ratio(member, iteration / (EVALUATIONS * EVERY))
                rows.add_metrics(iteration, made_metrics(tables[member.coordinates].size, value))
                if iteration % EVERY == 0:
                    rows.add_evaluation(iteration, made_flights(tables[member.coordinates].size, value))
            directory.write_slice(number, rows.tables, [])
        directory.gather(len(slices))
    return folder


def made_metrics(size, ratio):
    trials = np.full(size, EPISODES)
    counts = np.stack(
        [trials, np.round(trials * (1 - ratio) * np.linspace(0.5, 1.5, size)).clip(0, EPISODES)]
    )
    failed = round(1000 * (1 - ratio))
    return Metrics(counts.astype(int), np.array([1000, failed]), np.array(100.0), np.array(9.0), 0, {}, {})


def made_flights(size, ratio):
    config_id = np.repeat(np.arange(size), EPISODES)
    goal = np.arange(config_id.size) % EPISODES < round(EPISODES * ratio)
    return EvalResult(config_id, goal, 2000.0 * goal, np.full(goal.shape, 3), np.zeros((goal.size, 4, 2)))
