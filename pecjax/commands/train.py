"""`pecjax train`."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path

from pecjax.commands import settings_args
from pecjax.commands.drawing import draw
from pecjax.commands.options import Option, Rest, Strings
from pecjax.envs.rooms.settings import Rooms
from pecjax.errors import InputError
from pecjax.runtime import distributed as processes
from pecjax.training import train as training
from pecjax.training.kinds import kind_name
from pecjax.training.presets import find_preset
from pecjax.training.run_directory import RunDirectory
from pecjax.training.settings import override
from pecjax.training.sinks import Sink, TensorBoard, WandB


@dataclass(frozen=True)
class Train:
    """Trains a drone and writes a run folder with its figures.

    Attributes:
        preset: the settings to start from: fast, rllib085 (the paper's own), image (64×48) or gpu
            for ppo, apex-fast or apex-rllib085 for apex. (default: fast or apex-fast)
        agent: the learner: ppo, apex, or one of your own as my.module:Class. (default: the preset's)
        task: what is learned: rooms, or one of your own as my.module:Class. (default: rooms)
        sampler: how the next configuration is chosen: pec, uniform, table_top or another of
            docs/samplers.md, or one of your own as my.module:Class. (default: the preset's)
        alpha: α of PEC, 0 or more; the larger, the nearer to uniform. (default: 0.2)
        coordinates: the paper's set 1 or 2, or a file of configurations; --task.table. (default: what the
            maps mark, else 1)
        scene: maps as MJCF or text plans (.txt), files or folders; --task.maps. (default: the paper's
            six rooms)
        seed: of everything random in training. (default: 0)
        iterations: how many to train for. (default: the preset's)
        until_goal_ratio: stops once --patience iterations in a row have reached this training goal
            ratio.
        patience: how many iterations in a row must have reached the goal ratio. (default: 5)
        num_envs: environments flown side by side. (default: the preset's)
        devices: how many share them. (default: all that divide them evenly)
        out: the run's folder. (default: a new one under runs/)
        sampled_evaluation: evaluates with drawn actions instead of the most likely ones.
        tensorboard: writes for TensorBoard too, in tensorboard/ in the run's folder: docs/tracking.md.
        wandb: logs to this project of Weights & Biases too: docs/tracking.md.
        resume: resumes the run in --out where it was stopped, or with more --iterations.
        coordinator: where several processes share the training, given to all of them alike: HOST:PORT of
            the first, or auto under SLURM or Open MPI. (default: this process is alone)
        num_processes: how many there are. (not needed with --coordinator auto)
        process_id: the number of this process, from 0. (not needed with --coordinator auto)
        settings: options by their dotted paths (see `settings_args`).
    """

    preset: Option[str] = None
    agent: Option[str] = None
    task: Option[str] = None
    sampler: Option[str] = None
    alpha: Option[float] = None
    coordinates: Option[str] = None
    scene: Strings = None
    seed: Option[int] = None
    iterations: Option[int] = None
    until_goal_ratio: Option[float] = None
    patience: Option[int] = None
    num_envs: Option[int] = None
    devices: Option[int] = None
    out: Option[Path] = None
    sampled_evaluation: bool = False
    tensorboard: bool = False
    wandb: Option[str] = None
    resume: bool = False
    coordinator: Option[str] = None
    num_processes: Option[int] = None
    process_id: Option[int] = None
    settings: Rest = ()

    def run(self) -> None:
        """Trains, then draws."""
        self._join()
        if self.resume:  # what is given beside it must be as it was
            if self.out is None:
                raise InputError("--resume needs the run's folder; give it with --out")
            base = RunDirectory(self.out).settings()
            if self.preset is not None:
                base = dataclasses.replace(base, preset=self.preset)
        else:
            base = find_preset(self.preset, self.agent)
        settings = override(
            base,
            task=self.task,
            agent=self.agent,
            num_envs=self.num_envs,
            sampler=self.sampler,
            alpha=self.alpha,
            coordinates=self.coordinates,
            scene=self.scene,
            seed=self.seed,
            iterations=self.iterations,
            until_goal_ratio=self.until_goal_ratio,
            patience=self.patience,
            greedy=False if self.sampled_evaluation else None,
        )
        settings = settings_args.apply(settings, self.settings, Train)
        name = kind_name(settings.sampler).rpartition(":")[2].lower()
        folder = self.out or Path("runs") / time.strftime(f"{name}-%Y%m%d-%H%M%S")
        go = training.resume if self.resume else training.train
        summary = go(settings, folder, self.devices, self._trackers())
        if not processes.is_primary():
            return
        draw(folder)
        evaluated = summary["uniform_evaluation"]
        print(
            f"{folder}: goal ratio {evaluated['goal_ratio']:.3f} over {evaluated['episodes']} "
            f"{'greedy' if evaluated['greedy'] else 'sampled'} episodes of a uniform draw, after "
            f"{summary['env_steps']:,} steps in {summary['seconds']:.0f} s "
            f"(and {summary['compile_seconds']:.0f} s of compilation)"
        )
        if isinstance(settings.task, Rooms):
            print(f"pecjax watch {folder} shows its flights")

    def _trackers(self) -> list[Sink]:
        trackers: list[Sink] = [TensorBoard()] if self.tensorboard else []
        return trackers if self.wandb is None else [*trackers, WandB(self.wandb)]

    def _join(self) -> None:
        if self.coordinator is None:
            if self.num_processes is not None or self.process_id is not None:
                raise InputError("--num-processes and --process-id need --coordinator HOST:PORT")
            return
        if self.out is None:
            raise InputError("several processes need one folder that all of them see; give it with --out")
        processes.join(self.coordinator, self.num_processes, self.process_id)
