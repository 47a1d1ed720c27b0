"""Movies: the frames of some flights as an animated GIF or as an MP4."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from pecjax.runtime.extras import require
from pecjax.storage import files
from pecjax.viewing.recording import Flight, Recording

PAUSE = 1.0  # s for which the last frame stays
_COLORS = 64  # of a GIF; flat areas have few


def write_movie(path: Path, frames: Iterator[np.ndarray], period: float) -> None:
    """Writes a movie; the file is whole or not there.

    Args:
        path: ends in .gif or .mp4.
        frames: (H, W, 3) uint8 each, of even H and W.
        period: s between frames.

    Raises:
        InputError: the file cannot be written, or MP4 lacks its library.
    """
    write = _write_gif if path.suffix == ".gif" else _write_mp4
    new = path.with_name(f".new.{path.name}")
    with files.writing(path, "give another place"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with files.replacing(path, new):
            write(new, frames, period)


def _write_gif(path: Path, frames: Iterator[np.ndarray], period: float) -> None:
    from PIL import Image

    images = [Image.fromarray(frame) for frame in frames]
    some = np.concatenate([np.asarray(images[place]) for place in (0, len(images) // 2, -1)])
    colors = Image.fromarray(some).quantize(_COLORS)
    # With one palette and no dithering, a frame holds only what has changed.
    first, *rest = [image.quantize(palette=colors, dither=Image.Dither.NONE) for image in images]
    # GIF counts hundredths of a second.
    shown = [round(100 * period) * 10] * len(rest) + [round(1000 * PAUSE)]
    first.save(path, save_all=True, append_images=rest, duration=shown, loop=0)


def _write_mp4(path: Path, frames: Iterator[np.ndarray], period: float) -> None:
    av: Any = require("av", extra="video")
    first = next(frames)
    with av.open(path, "w", format="mp4") as file:
        stream = file.add_stream("libx264", rate=Fraction(1 / period).limit_denominator(1000))
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"  # which all players know
        last = first
        for last in itertools.chain([first], frames):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(last)))
        for _ in range(round(PAUSE / period)):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(last)))
        file.mux(stream.encode())


def followed(recording: Recording) -> Flight:
    """The flight that a movie follows: of those that reach their goal, else of all, one of middle length."""
    reached = [flight for flight in recording.flights if flight.ending == "goal"]
    by_length = sorted(reached or recording.flights, key=lambda flight: len(flight.commands))
    return by_length[len(by_length) // 2]
