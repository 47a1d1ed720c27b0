"""Trained runs: a run's folder opened again, to fly its policy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from pecjax.envs.rooms.scene import load_scene
from pecjax.runtime.devices import choose_num_devices
from pecjax.training.build import Run, abstract_state, build
from pecjax.training.checkpoint import Checkpoints
from pecjax.training.presets import RunSettings
from pecjax.training.run_directory import RunDirectory


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
