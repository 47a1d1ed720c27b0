"""Trained runs: a run's folder opened again, to fly its policy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from pecjax.experiments.assembly import Run, abstract_state, build
from pecjax.experiments.checkpoint import Checkpoints
from pecjax.experiments.devices import choose_num_devices
from pecjax.experiments.presets import RunSettings
from pecjax.experiments.run_directory import RunDirectory
from pecjax.world.scene import load_scene


class Trained(NamedTuple):
    """A run as it stood at a checkpoint.

    Attributes:
        settings: of the run.
        run: world, sampler and agent.
        iteration: the checkpoint's.
        learner: the agent's parameters and what belongs to them.
    """

    settings: RunSettings
    run: Run
    iteration: int
    learner: Any

    def policy(self, greedy: bool = True) -> Callable[[Any, Any], Any]:
        """act(obs, key) -> action for a single observation of `run.env`; it can be jitted."""
        return self.run.agent.policy(self.learner, greedy)


def open_run(folder: Path, checkpoint: int | None = None) -> Trained:
    """Reads a run's settings, map, coordinates and one of its checkpoints, the newest when None.

    Raises:
        InputError: the folder holds no run, or no such checkpoint.
    """
    directory = RunDirectory(folder)
    settings = directory.settings()
    num_devices = choose_num_devices(None, settings.learner.shares)
    scene = load_scene(directory.scene_path, settings.resolution)
    run = build(settings, scene, directory.table(), num_devices, trains=False)
    iteration, learner = Checkpoints(folder).load_learner(abstract_state(run).learner, checkpoint)
    return Trained(settings, run, iteration, learner)
