"""Checkpoints: a whole TrainState on disk, by iteration."""

from __future__ import annotations

import importlib
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import jax

from pecjax.agents.agent import TrainState
from pecjax.errors import InputError


def _orbax() -> ModuleType:
    """Orbax: importing it takes over a second, which only saving and loading shall pay."""
    return importlib.import_module("orbax.checkpoint")


class Checkpoints:
    """The checkpoints of one run folder; the only place that knows Orbax.

    Every learner is kept, in `checkpoints`, so that policies can be had and compared; of the rest
    (sampler, environments, replay), which may be large, only the newest two, in `states`.
    """

    def __init__(self, folder: Path) -> None:
        """Names the folders, which are made with the first checkpoint."""
        self._folder = (folder / "checkpoints").absolute()
        self._states_folder = (folder / "states").absolute()

    @cached_property
    def _manager(self) -> Any:
        ocp = _orbax()
        options = ocp.CheckpointManagerOptions(enable_async_checkpointing=False)
        return ocp.CheckpointManager(self._folder, options=options)

    @cached_property
    def _states(self) -> Any:
        ocp = _orbax()
        options = ocp.CheckpointManagerOptions(enable_async_checkpointing=False, max_to_keep=2)
        return ocp.CheckpointManager(self._states_folder, options=options)

    def save(self, iteration: int, state: TrainState) -> None:
        """Writes the state after `iteration` iterations."""
        rest = state._replace(learner=None, key=jax.random.key_data(state.key))
        ocp = _orbax()
        self._states.save(iteration, args=ocp.args.Composite(rest=ocp.args.StandardSave(rest._asdict())))
        self._manager.save(iteration, args=ocp.args.Composite(learner=ocp.args.StandardSave(state.learner)))

    def iterations(self) -> list[int]:
        """The iterations at which a checkpoint was saved, rising."""
        return sorted(self._manager.all_steps()) if self._folder.is_dir() else []

    def load_learner(self, like: Any, iteration: int | None = None) -> tuple[int, Any]:
        """The learner's part of a checkpoint, the newest when `iteration` is None.

        Args:
            like: a learner of the same structure, of arrays or their shapes.

        Raises:
            InputError: there is no such checkpoint.
        """
        there = self.iterations()
        if not there:
            raise InputError(f"{self._folder}: no checkpoint; train first")
        if iteration is not None and iteration not in there:
            listed = ", ".join(map(str, there))
            raise InputError(f"{self._folder}: no checkpoint {iteration}; there are {listed}")
        iteration = there[-1] if iteration is None else iteration
        ocp = _orbax()
        items = ocp.args.Composite(learner=ocp.args.StandardRestore(like))
        return iteration, self._manager.restore(iteration, args=items)["learner"]
