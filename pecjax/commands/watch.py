"""`pecjax watch`."""

from __future__ import annotations

import importlib
import os
import sys
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pecjax.commands.flown import Flown
from pecjax.commands.options import Option
from pecjax.errors import InputError
from pecjax.storage import files
from pecjax.training.demos import find_run, is_demo
from pecjax.training.kinds import run_label
from pecjax.training.rows import episode_arrays, recording_arrays
from pecjax.viewing.history import History
from pecjax.viewing.movie import followed, write_movie
from pecjax.viewing.mujoco_view import mujoco_frames
from pecjax.viewing.page import page
from pecjax.viewing.recording import Recording, make_recording, read_recording


@dataclass(frozen=True)
class Watch(Flown):
    """Shows flights of a trained drone: a page for the browser, or a GIF or MP4.

    The page is one file that loads nothing from anywhere. It shows the flights of the run's last
    evaluation, and how its sampler drew the configurations; with --episodes, --checkpoint, --space or
    another option that says what to fly in, new flights.

    Attributes:
        out: the page. (default: watch.html in the run's folder; of a demo, in the folder you are in)
        open: opens the page in the browser.
        flights: the most that are shown.
        episodes: flies so many new ones, spread evenly over the configurations. (default: none)
        seed: of the headings and drawn actions of new flights.
        gif: writes a GIF of this name in place of the page.
        mp4: writes an MP4 of this name in place of the page; it needs the extra pecjax[video].
        renderer: of GIF and MP4: top (from above, with the depth image) or mujoco (in three dimensions;
            it needs OpenGL).
    """

    out: Option[Path] = None
    open: bool = True
    flights: int = 50
    episodes: Option[int] = None
    seed: int = 1
    gif: Option[Path] = None
    mp4: Option[Path] = None
    renderer: Literal["top", "mujoco"] = "top"

    def run(self) -> None:
        """Writes the page or the movie."""
        if self.flights < 1:
            raise InputError(f"flights is {self.flights}; give 1 or more")
        movies = [path for path in (self.gif, self.mp4) if path is not None]
        if movies and self.out is not None:
            raise InputError("--out is the page's, which is not written with --gif or --mp4; leave one out")
        for path, suffix in ((self.gif, ".gif"), (self.mp4, ".mp4"), (self.out, ".html")):
            if path is not None and path.suffix != suffix:
                raise InputError(f"{path}: give a name that ends in {suffix}")
        recording, history = self._recorded() if self._as_recorded() else (self._flown(), None)
        for path in movies:
            write_movie(path, self._frames(recording), recording.task.settings.control_period)
            print(path)
        if not movies:
            out = self.out or self._default_page()
            with files.writing(out, "give another place with --out"):
                out.parent.mkdir(parents=True, exist_ok=True)
                files.replace_file(out, page(recording, history))
            print(f"{out}: {len(recording.flights)} flights; open it in a browser")
            if self.open and _has_screen():
                webbrowser.open(out.absolute().as_uri())

    def _as_recorded(self) -> bool:
        """Whether nothing was said of what to fly in."""
        asked = (self.episodes, self.checkpoint, self.space, self.split, self.coordinates, self.scene)
        return not self.sampled and all(option is None for option in asked)

    def _recorded(self) -> tuple[Recording, History]:
        return read_recording(find_run(self.folder), self.flights)

    def _flown(self) -> Recording:
        trained, result = self.fly(self.flights if self.episodes is None else self.episodes, self.seed)
        arrays = episode_arrays(result) | recording_arrays(result, np.arange(len(result.success)))
        title = f"{run_label(trained.settings)}, after iteration {trained.iteration}"
        return make_recording(title, trained.run.task, trained.run.eval_world, arrays, self.flights)

    def _frames(self, recording: Recording) -> Iterator[np.ndarray]:
        follow = followed(recording)
        if self.renderer == "mujoco":
            return mujoco_frames(recording, follow)
        # Loaded only here: matplotlib would hold up the rest by a second.
        return importlib.import_module("pecjax.viewing.top_view").top_frames(recording, follow)

    def _default_page(self) -> Path:
        return Path(f"{self.folder}.html") if is_demo(self.folder) else self.folder / "watch.html"


def _has_screen() -> bool:
    """Whether there is a desktop; without one `webbrowser` may begin a browser in the terminal."""
    return sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
