"""Checkpoints: states to resume from, and policies by iteration."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pecjax.agents import TrainState
from pecjax.errors import InputError
from pecjax.runtime.distributed import primary_only
from pecjax.storage.arrays import CorruptFileError, by_iteration, iterations_in, read_arrays, write_arrays

KEPT_STATES = 2  # the newest, and one to fall back on


class ResumeState(NamedTuple):
    """Where a training stands: all that it needs, beside its tables, to resume as if it had never stopped.

    Attributes:
        state: of environments, sampler and learner.
        iteration: how many iterations are done.
        seconds: spent so far, compilation apart.
    """

    state: TrainState
    iteration: np.ndarray
    seconds: np.ndarray

    @classmethod
    def make(cls, state: TrainState, iteration: int, seconds: float) -> ResumeState:
        """The same with its numbers as arrays."""
        return cls(state, np.array(iteration), np.array(seconds))


class Checkpoints:
    """The checkpoints of one run folder.

    Every evaluated learner is kept, in `checkpoints`, so that policies can be had and compared; of
    whole states to resume from, which may be large, only the newest, in `states`.
    """

    def __init__(self, folder: Path, about: dict[str, Any] | None = None) -> None:
        """Names the folders, which are made with the first checkpoint.

        Args:
            about: what a state must belong to for a training to resume from it.
        """
        self._about = about
        self._learners = folder / "checkpoints"
        self._states = folder / "states"

    def save_learner(self, iteration: int, learner: Any) -> None:
        """Keeps the learner after `iteration` iterations."""
        write_arrays(by_iteration(self._learners, iteration), learner)

    def save_state(self, state: ResumeState) -> None:
        """Keeps a state to resume from, and removes what is older than the one before."""
        write_arrays(by_iteration(self._states, int(state.iteration)), state, self._about)
        self._prune()

    @primary_only
    def _prune(self) -> None:
        for iteration in iterations_in(self._states)[:-KEPT_STATES]:
            by_iteration(self._states, iteration).unlink()

    @primary_only
    def forget_after(self, iteration: int, every: int) -> None:
        """Removes learners and states that a run of which `iteration` iterations are done would not have."""
        for there in iterations_in(self._learners):
            if there > iteration or there % every:
                by_iteration(self._learners, there).unlink()
        for there in iterations_in(self._states):
            if there > iteration:
                by_iteration(self._states, there).unlink()

    def iterations(self) -> list[int]:
        """The iterations at which a learner was kept, rising."""
        return iterations_in(self._learners)

    def load_learner(self, like: Any, iteration: int | None = None) -> tuple[int, Any]:
        """A kept learner, the newest when `iteration` is None.

        Args:
            like: a learner of the same structure, of arrays or their shapes.

        Raises:
            InputError: there is no such checkpoint, or it is corrupt.
        """
        there = self.iterations()
        if not there:
            raise InputError(f"{self._learners}: no checkpoint; train first")
        if iteration is not None and iteration not in there:
            listed = ", ".join(map(str, there))
            raise InputError(f"{self._learners}: no checkpoint {iteration}; there are {listed}")
        iteration = there[-1] if iteration is None else iteration
        try:
            return iteration, read_arrays(by_iteration(self._learners, iteration), like)
        except CorruptFileError as error:
            raise InputError(f"{error}; choose another with --checkpoint") from error

    def load_state(self, like: ResumeState) -> tuple[ResumeState, list[str]]:
        """The newest whole state to resume from, and warnings of corrupt ones on the way to it.

        Raises:
            InputError: there is none, or it is of other settings.
        """
        warnings = []
        for iteration in reversed(iterations_in(self._states)):
            try:
                path = by_iteration(self._states, iteration)
                return read_arrays(path, like, self._about), warnings
            except CorruptFileError as error:
                warnings.append(f"{error}; falling back to the previous checkpoint")
        reason = "; ".join(warnings) or "no state to resume from"
        raise InputError(f"{self._states}: {reason}; train anew in another folder")
