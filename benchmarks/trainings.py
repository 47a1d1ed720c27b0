"""Trainings: workloads of whole ones, several at once, and of what they keep."""

from __future__ import annotations

import tempfile
from pathlib import Path

import jax
import numpy as np
from workloads import Workload

import pecjax
from pecjax.studies.grid import StudySettings
from pecjax.training import build as assembly, train as training
from pecjax.training.checkpoint import Checkpoints, ResumeState
from pecjax.training.presets import PRESETS, RunSettings
from pecjax.training.program import make_program


def study(alphas: tuple[float, ...], at_once: int) -> Workload:
    """One iteration of every run of a study with one seed, slice by slice, the preset `fast`."""
    settings = StudySettings("own", PRESETS["fast"], ("pec",), alphas, seeds=(0,), at_once=at_once)
    scene, table = pecjax.load_scene(), pecjax.COORDINATE_SET_1
    programs, states = {}, []
    for members in settings.slices():
        number = len(members)
        if number not in programs:
            programs[number] = make_program(settings.run, scene, table, number)
        seeds = np.array([member.seed for member in members], np.int32)
        numbers = {"alpha": np.array([member.alpha for member in members], np.float32)}
        states.append((number, programs[number].init(seeds, numbers)))

    def run() -> None:
        for place, (number, state) in enumerate(states):
            state, metrics = programs[number].iterate(state)
            jax.block_until_ready(metrics)
            states[place] = (number, state)

    amount = len(alphas) * programs[at_once].steps_per_iteration
    return Workload(run, amount, "control steps/s")


def checkpointing(settings: RunSettings) -> tuple[Workload, Workload]:
    """The iterations between two checkpoints, and the checkpoint after them."""
    _, scene, table = assembly.load_world(settings)
    run = assembly.build(settings, scene, table, len(jax.devices()))
    state, iterate = training.start(run, seed=0)
    carry, counts = [state, 0], np.zeros((2, table.size), np.int64)
    folder = tempfile.TemporaryDirectory()
    checkpoints = Checkpoints(Path(folder.name), about={"settings": str(settings)})

    def interval() -> None:
        for _ in range(settings.evaluate_every):
            carry[0], metrics = iterate(carry[0])
            jax.device_get(metrics)

    def checkpoint(folder: tempfile.TemporaryDirectory = folder) -> None:  # which lives as long as this
        carry[1] += 1
        checkpoints.save_learner(carry[1], carry[0].learner)
        checkpoints.save_position(ResumeState.make(carry[0], carry[1], counts, 0, 0.0))

    return Workload(interval, 1, "times/s"), Workload(checkpoint, 1, "times/s")
