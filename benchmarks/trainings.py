"""Trainings: workloads of whole ones, several at once, and of what they keep."""

from __future__ import annotations

import tempfile
from pathlib import Path

import jax
from workloads import Workload

from pecjax.studies.grid import StudySettings
from pecjax.training.build import build
from pecjax.training.checkpoint import Checkpoints, ResumeState
from pecjax.training.presets import PRESETS
from pecjax.training.program import several_runs, start
from pecjax.training.settings import RunSettings


def study(alphas: tuple[float, ...], parallel_runs: int) -> Workload:
    """One iteration of every run of a study with one seed, batch by batch, the preset `fast`."""
    grid = (("sampler", ("pec",)), ("sampler.alpha", alphas))
    settings = StudySettings("own", PRESETS["fast"], grid, seeds=(0,), parallel_runs=parallel_runs)
    task, world = settings.run.task.make()
    programs, states = {}, []
    for specs in settings.batches():
        number = len(specs)
        if number not in programs:
            programs[number] = several_runs(settings.run, task, world, number)
        state = programs[number].init([spec.seed for spec in specs], settings.numbers(specs))
        states.append((number, state))

    def run() -> None:
        for place, (number, state) in enumerate(states):
            state, metrics = programs[number].program.iterate(state)
            jax.block_until_ready(metrics)
            states[place] = (number, state)

    amount = len(alphas) * programs[parallel_runs].program.steps_per_iteration
    return Workload(run, amount, "control steps/s")


def checkpointing(settings: RunSettings) -> tuple[Workload, Workload]:
    """The iterations between two checkpoints, and the checkpoint after them."""
    state, iterate = start(build(settings, len(jax.devices())), seed=0)
    carry = [state, 0]
    folder = tempfile.TemporaryDirectory()
    checkpoints = Checkpoints(Path(folder.name), about={"settings": str(settings)})

    def interval() -> None:
        for _ in range(settings.evaluation.every):
            carry[0], metrics = iterate(carry[0])
            jax.device_get(metrics)

    def checkpoint(folder: tempfile.TemporaryDirectory = folder) -> None:  # which lives as long as this
        carry[1] += 1
        checkpoints.save_learner(carry[1], carry[0].learner)
        checkpoints.save_state(ResumeState.make(carry[0], carry[1], 0.0))

    return Workload(interval, 1, "times/s"), Workload(checkpoint, 1, "times/s")
