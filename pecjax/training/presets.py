"""Presets: the settings of a run, by name, and their checks."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from pecjax import settings_tree
from pecjax.agents.apex_update import ApexSettings
from pecjax.agents.networks import NetworkSettings
from pecjax.agents.ppo_update import PPOSettings
from pecjax.agents.q_network import QNetworkSettings
from pecjax.agents.replay import ReplaySettings
from pecjax.curriculum import PEC, SamplerSettings
from pecjax.errors import InputError
from pecjax.training.limits import check_amounts
from pecjax.training.samplers import has_alpha, make_sampler, sampler_name


@dataclass(frozen=True)
class RunSettings:
    """Everything that a run depends on, but for the map and the coordinates themselves.

    Attributes:
        preset: the name these settings began from.
        algorithm: the learner: `ppo` or `apex`.
        ppo, apex: the settings of either.
        resolution: (width, height) of the depth image, None for what the scene's camera says.
        sampler: how the next configuration is chosen.
        coordinates: the paper's set 1 or 2, or a file.
        scene: an MJCF file, None for the six rooms.
        seed: of everything random in training.
        iterations: how many to train for, at most.
        until_goal_ratio: the training goal ratio to stop at, once `patience` iterations in a row
            have reached it; None to go on to the end.
        patience: iterations in a row, for `until_goal_ratio`.
        evaluate_every: iterations between evaluations, each saved as a checkpoint.
        evaluation_episodes: episodes of each, spread evenly over the configurations.
        evaluation_seed: of the evaluations, the same for all runs, so that they are paired.
        greedy: whether evaluations take the likeliest action; else they draw, as training does.
        configurations_every: iterations between rows of configurations.csv.
    """

    preset: str = "fast"
    algorithm: str = "ppo"
    ppo: PPOSettings = field(default_factory=PPOSettings)
    apex: ApexSettings = field(default_factory=ApexSettings)
    resolution: tuple[int, int] | None = None
    sampler: SamplerSettings = PEC()
    coordinates: str = "1"
    scene: str | None = None
    seed: int = 0
    iterations: int = 457
    until_goal_ratio: float | None = None
    patience: int = 5
    evaluate_every: int = 50
    evaluation_episodes: int = 200
    evaluation_seed: int = 2022
    greedy: bool = True
    configurations_every: int = 10

    @property
    def learner(self) -> PPOSettings | ApexSettings:
        """The settings of the algorithm that is run."""
        return self.apex if self.algorithm == "apex" else self.ppo


# Every setting that Jang & Choi (2022, §5.2) name, and RLlib 0.8.5's defaults for the rest.
_RLLIB_085 = PPOSettings(
    num_envs=40,
    num_steps=125,
    num_epochs=30,
    num_minibatches=39,
    shuffle="samples",
    learning_rate=5e-5,
    adam_eps=1e-8,
    max_grad_norm=None,
    discount=0.99,
    gae_lambda=0.95,
    clip=0.2,
    value_clip=10.0,
    value_coeff=1.0,
    entropy_coeff=0.0,
    kl_coeff=1.0,
    kl_target=0.01,
    reward_scale=1.0,
    network=NetworkSettings(hidden=(256, 256), initializer="normc"),
)

# The same for Ape-X; what RLlib leaves to asynchrony is chosen here: environments side by side,
# steps between updates, and the replay ratio.
_APEX_RLLIB_085 = ApexSettings(
    num_envs=20,
    num_steps=1250,
    num_actors=5,
    fragment=50,
    n_step=3,
    discount=0.99,
    batch_size=5000,
    replay_ratio=5.0,
    learning_starts=50_000,
    target_period=20_000,
    learning_rate=5e-4,
    decay_updates=None,
    adam_eps=1e-8,
    max_grad_norm=40.0,
    huber=1.0,
    reward_scale=1.0,
    network=QNetworkSettings(trunk=(256, 256), head=256),
    replay=ReplaySettings(capacity=2_000_000, stratified=False, normalize="shard"),
)

PRESETS: dict[str, RunSettings] = {
    "fast": RunSettings(),
    "rllib085": RunSettings(
        preset="rllib085", ppo=_RLLIB_085, iterations=1500, evaluate_every=100, evaluation_episodes=50
    ),
    "image": RunSettings(
        preset="image",
        ppo=PPOSettings(num_envs=256, network=NetworkSettings(encoder="cnn", hidden=(64, 64))),
        resolution=(64, 48),
    ),
    "apex-fast": RunSettings(preset="apex-fast", algorithm="apex", iterations=450, evaluate_every=25),
    "apex-rllib085": RunSettings(
        preset="apex-rllib085",
        algorithm="apex",
        apex=_APEX_RLLIB_085,
        iterations=2000,
        evaluate_every=100,
        evaluation_episodes=50,
    ),
}
DEFAULT_PRESETS = {"ppo": "fast", "apex": "apex-fast"}


def find_preset(name: str | None = None, algorithm: str | None = None) -> RunSettings:
    """The preset of that name, the algorithm's default preset when None.

    Raises:
        InputError: there is no such preset or algorithm, or they do not go together.
    """
    if algorithm is not None and algorithm not in DEFAULT_PRESETS:
        raise InputError(f"unknown algorithm '{algorithm}'; choose one of {', '.join(DEFAULT_PRESETS)}")
    name = name or DEFAULT_PRESETS[algorithm or "ppo"]
    if name not in PRESETS:
        raise InputError(f"unknown preset '{name}'; choose one of {', '.join(PRESETS)}")
    found = PRESETS[name]
    if algorithm not in (None, found.algorithm):
        raise InputError(f"preset '{name}' trains with {found.algorithm}; leave out --algorithm {algorithm}")
    return found


def check_settings(settings: RunSettings) -> None:
    """Makes sure that the settings can be run with; the samplers check their numbers themselves.

    Raises:
        InputError: the first setting that cannot.
    """
    find_preset(algorithm=settings.algorithm)
    settings.sampler.make(1)
    counts = {
        "iterations": settings.iterations,
        "num-envs": settings.learner.num_envs,
        "patience": settings.patience,
        "evaluate-every": settings.evaluate_every,
        "evaluation-episodes": settings.evaluation_episodes,
        "configurations-every": settings.configurations_every,
    }
    for name, value in counts.items():
        if value < 1:
            raise InputError(f"{name} is {value}; it must be at least 1")
    goal_ratio = settings.until_goal_ratio
    if goal_ratio is not None and not 0 < goal_ratio <= 1:
        raise InputError(f"until-goal-ratio is {goal_ratio}; it must lie above 0 and be at most 1")
    for seed in (settings.seed, settings.evaluation_seed):
        if not 0 <= seed < 2**31:
            raise InputError(f"seed is {seed}; it must lie in 0 to 2147483647")
    check_amounts(settings)


def override(
    settings: RunSettings,
    num_envs: int | None = None,
    sampler: str | None = None,
    alpha: float | None = None,
    **changes: object,
) -> RunSettings:
    """The settings with every change that is not None.

    Args:
        sampler: a name; where it is that of the sampler there is, its numbers stay.

    Raises:
        InputError: no such sampler, or one that has no α.
    """
    if sampler is not None:
        settings = dataclasses.replace(settings, sampler=make_sampler(sampler, settings.sampler))
    if alpha is not None:
        if not has_alpha(settings.sampler):
            name = sampler_name(settings.sampler)
            raise InputError(f"the sampler {name} has no alpha; leave out --alpha")
        settings = settings_tree.set_path(settings, "sampler.alpha", alpha)
    if num_envs is not None:
        learner = settings.learner.with_envs(num_envs)
        settings = dataclasses.replace(settings, **{settings.algorithm: learner})
    return dataclasses.replace(settings, **{k: v for k, v in changes.items() if v is not None})
