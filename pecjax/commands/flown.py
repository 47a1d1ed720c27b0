"""What `pecjax eval` and `pecjax watch` both let a policy fly in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import tyro

from pecjax.commands.options import Option, Strings
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.rooms.spaces.elsewhere import evaluated_rooms
from pecjax.errors import InputError
from pecjax.training.load import Trained, open_run
from pecjax.training.program import compile_evaluator
from pecjax.training.run_episodes import EvalResult
from pecjax.training.settings import EvaluationSettings, check_settings


@dataclass(frozen=True)
class Flown:
    """A policy and the configurations that it is to fly in.

    Attributes:
        folder: the run's folder, or demo, demo-set-1 or demo-set-2 for a policy that comes with pecjax.
        checkpoint: the iteration it was saved at. (default: the newest)
        sampled: draws actions from the policy; else the most likely one is taken.
        space: a named space, or the file of one. (default: the run's own)
        split: train or held-out, of a space. (default: held-out)
        coordinates: the paper's set 1 or 2, or a file of configurations. (default: the run's own)
        scene: maps as MJCF or text plans (.txt), files or folders. (default: the run's own)
    """

    folder: tyro.conf.Positional[Path]
    checkpoint: Option[int] = None
    sampled: bool = False
    space: Option[str] = None
    split: Option[str] = None
    coordinates: Option[str] = None
    scene: Strings = None

    def fly(self, episodes: int, seed: int) -> tuple[Trained, EvalResult]:
        """Runs so many episodes, an even draw of the configurations.

        Returns:
            the run, set up where it was flown, and the episodes.

        Raises:
            InputError: no such run or checkpoint, or something that does not go together.
        """
        trained = self._there(open_run(self.folder, self.checkpoint))
        about = EvaluationSettings(episodes=episodes, seed=seed, greedy=not self.sampled)
        settings = dataclasses.replace(trained.settings, evaluation=about)
        check_settings(settings)
        evaluate = compile_evaluator(trained.run, settings, trained.learner)
        return trained, evaluate(trained.learner, trained.run.eval_world)

    def _there(self, trained: Trained) -> Trained:
        """The policy in the configurations that are asked for."""
        task, asked = trained.settings.task, (self.space, self.split, self.coordinates, self.scene)
        if isinstance(task, Rooms):
            return trained.elsewhere(*evaluated_rooms(task, trained.run.world, *asked))
        if any(asked):
            raise InputError("the run is of a task without spaces or maps; leave out what it is evaluated in")
        return trained
