"""The arrays of a finished run, read with one line for what is wrong with them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping

import numpy as np

from pecjax.errors import InputError
from pecjax.training.run_directory import RunDirectory

ENDINGS = ("goal", "collision", "timeout", "other")  # of an episode


@contextlib.contextmanager
def last_recording(run: RunDirectory) -> Iterator[dict[str, np.ndarray]]:
    """The arrays of the last evaluation's episodes, some of which are recorded (see `rows.recording_arrays`).

    Raises:
        InputError: the run is not finished, or what is made of its arrays meanwhile cannot be made of them.
    """
    kept = run.iterations("episodes")
    if not kept or "poses" not in run.arrays("episodes", kept[-1]):
        raise InputError(f"{run.folder / 'episodes'}: no flights of a finished run; train it to its end")
    with run_arrays(run, "episodes", kept[-1]) as arrays:
        yield arrays


def endings(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """How each of an evaluation's episodes ended: (E,), one of `ENDINGS`."""
    there = [kind for kind in ENDINGS[1:3] if kind in arrays]  # metrics that some tasks have
    kinds = [arrays["success"], *(arrays[kind] for kind in there)]
    return np.select([np.asarray(kind) > 0 for kind in kinds], [ENDINGS[0], *there], ENDINGS[3])


@contextlib.contextmanager
def run_arrays(run: RunDirectory, name: str, iteration: int) -> Iterator[dict[str, np.ndarray]]:
    """The arrays that a run has kept.

    Raises:
        InputError: they cannot be read, or what is made of them meanwhile cannot be made of them.
    """
    try:
        yield run.arrays(name, iteration)
    except InputError:
        raise
    except (KeyError, IndexError, ValueError, TypeError) as error:
        path = run.folder / name / f"{iteration}.npz"
        raise InputError(f"{path}: not the arrays of a run ({error!r}); train again") from error
