"""Workers: a function over numbered plans, in this process or in several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Chunk = TypeVar("Chunk")
T = TypeVar("T")
CHUNK = 250  # plans; the start of a process takes as long as a few hundred plans do


def chunks_of(number: int) -> list[tuple[int, int]]:
    """The (from, to) of each chunk of 0 to `number`."""
    return [(begin, min(begin + CHUNK, number)) for begin in range(0, number, CHUNK)]


def over_chunks(function: Callable[[Chunk], T], chunks: Sequence[Chunk], workers: int) -> list[T]:
    """What the function gives for each chunk, in order.

    Args:
        workers: processes, started anew and not forked: JAX's threads would not live in a fork. Whatever
            their number, the chunks are the same.
    """
    workers = min(workers, len(chunks) // 2)
    if workers <= 1:
        return [function(chunk) for chunk in chunks]
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(function, chunks))
