"""Loading: opens a run's folder to run its policy."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from pecjax.envs.task import EvalSet, World
from pecjax.runtime.devices import choose_num_devices
from pecjax.training.build import Run, abstract_state, build, everywhere
from pecjax.training.checkpoint import Checkpoints
from pecjax.training.demos import find_run
from pecjax.training.program import compile_evaluator
from pecjax.training.run_directory import RunDirectory
from pecjax.training.run_episodes import EvalResult
from pecjax.training.settings import RunSettings, check_settings


class Trained(NamedTuple):
    """A run at one of its checkpoints.

    Attributes:
        settings: of the run; its task reads the files in the run's folder.
        run: task, world, sampler and agent.
        iteration: the checkpoint's.
        learner: the agent's parameters and the state that belongs to them.
    """

    settings: RunSettings
    run: Run
    iteration: int
    learner: Any

    def policy(self, greedy: bool = True) -> Callable[[Any, Any], Any]:
        """act(obs, key) -> action for a single observation of `run.task`; it can be jitted.

        With a memory it is act(obs, key, memory) -> (action, memory), from `run.agent.first_memory` on.
        """
        return self.run.agent.policy(self.learner, greedy)

    def elsewhere(self, world: World, eval_set: EvalSet) -> Trained:
        """The same policy, to be evaluated in another world.

        Raises:
            InputError: its configurations have objectives that the policy was not trained with.
        """
        eval_set = eval_set._replace(table=self.run.task.fitted(eval_set.table))
        there = everywhere(world._replace(table=eval_set.table), self.run.mesh)
        return self._replace(run=self.run._replace(eval_set=eval_set, eval_world=there))

    def evaluator(self) -> Callable[..., EvalResult]:
        """evaluate(world=None) -> EvalResult, as the run's settings evaluate it, by default in its own world.

        It is compiled once. Another world of the same shapes, such as unseen maps, compiles nothing.
        """
        compiled = compile_evaluator(self.run, self.settings, self.learner)

        def evaluate(world: World | None = None) -> EvalResult:
            there = self.run.eval_world if world is None else everywhere(world, self.run.mesh)
            return compiled(self.learner, there)

        return evaluate


def open_run(folder: str | Path, checkpoint: int | None = None) -> Trained:
    """Reads a run's settings, its task's files and one of its checkpoints, the newest when None.

    The folder may be the name of a demo, where there is no such folder.

    Raises:
        InputError: the folder holds no run, or no such checkpoint.
    """
    folder = find_run(Path(folder))
    directory = RunDirectory(folder)
    settings = dataclasses.replace(directory.settings(), task=directory.task())
    check_settings(settings)
    num_devices = choose_num_devices(None, settings.agent.device_divisor, settings.agent.divided)
    run = build(settings, num_devices, trains=False)
    iteration, learner = Checkpoints(folder).load_learner(abstract_state(run).learner, checkpoint)
    return Trained(settings, run, iteration, learner)
