"""Presets: settings of a run by name."""

from __future__ import annotations

import dataclasses

from pecjax.agents import PPO, Apex
from pecjax.agents.apex.q_network import QNetworkSettings
from pecjax.agents.apex.replay import ReplaySettings
from pecjax.agents.networks import NetworkSettings
from pecjax.envs.rooms.settings import Rooms
from pecjax.errors import InputError, nearest
from pecjax.training.kinds import kind_name, make_kind
from pecjax.training.settings import EvaluationSettings, RunSettings, StopSettings

# Every setting that Jang & Choi (2022, §5.2) name, and RLlib 0.8.5's defaults for the rest.
_RLLIB_085 = PPO(
    num_envs=40,
    num_steps=125,
    num_epochs=30,
    num_minibatches=39,
    shuffle="samples",
    learning_rate=5e-5,
    decay_steps=None,
    adam_eps=1e-8,
    max_grad_norm=None,
    discount=0.99,
    gae_lambda=0.95,
    clip_epsilon=0.2,
    value_clip=10.0,
    value_coeff=1.0,
    entropy_coeff=0.0,
    kl_coeff=1.0,
    kl_target=0.01,
    reward_scale=1.0,
    network=NetworkSettings(
        hidden=(256, 256), initializer="normc", critic="observation", precision="float32"
    ),
)

# The same for Ape-X; what RLlib leaves to asynchrony is chosen here: environments side by side,
# steps between updates, and the replay ratio.
_APEX_RLLIB_085 = Apex(
    num_envs=20,
    num_steps=1250,
    num_actors=5,
    rollout_length=50,
    n_step=3,
    discount=0.99,
    batch_size=5000,
    replay_ratio=5.0,
    learning_starts=50_000,
    target_period=20_000,
    learning_rate=5e-4,
    decay_steps=None,
    adam_eps=1e-8,
    max_grad_norm=40.0,
    huber_delta=1.0,
    reward_scale=1.0,
    network=QNetworkSettings(trunk=(256, 256), head=256),
    replay=ReplaySettings(capacity=2_000_000, stratified=False, normalize="shard"),
)

PRESETS: dict[str, RunSettings] = {
    "fast": RunSettings(),
    "rllib085": RunSettings(
        preset="rllib085",
        agent=_RLLIB_085,
        stop=StopSettings(iterations=1500),
        evaluation=EvaluationSettings(every=100, episodes=50),
    ),
    "gpu": RunSettings(
        preset="gpu",
        agent=PPO(num_envs=8192, num_steps=16, num_minibatches=16),
        stop=StopSettings(iterations=115),
        evaluation=EvaluationSettings(every=10),
    ),
    "image": RunSettings(
        preset="image",
        agent=PPO(num_envs=256, network=NetworkSettings(encoder="cnn", hidden=(64, 64))),
        task=Rooms(resolution=(64, 48)),
    ),
    "apex-fast": RunSettings(
        preset="apex-fast",
        agent=Apex(),
        stop=StopSettings(iterations=450),
        evaluation=EvaluationSettings(every=25),
    ),
    "apex-rllib085": RunSettings(
        preset="apex-rllib085",
        agent=_APEX_RLLIB_085,
        stop=StopSettings(iterations=2000),
        evaluation=EvaluationSettings(every=100, episodes=50),
    ),
}
_DEFAULTS = {"ppo": "fast", "apex": "apex-fast"}


def find_preset(name: str | None = None, agent: str | None = None) -> RunSettings:
    """The preset of that name, or the one that goes with the agent.

    Args:
        agent: ppo, apex, or another kind that is put in the place of the preset's own.

    Raises:
        InputError: there is no such preset or agent, or they do not go together.
    """
    if name is None:
        name = _DEFAULTS.get(agent or "ppo", "fast")
    if name not in PRESETS:
        near = nearest(name, [*PRESETS])
        raise InputError(f"unknown preset '{name}'{near}; choose one of {', '.join(PRESETS)}")
    found = PRESETS[name]
    if agent is None or agent == kind_name(found.agent):
        return found
    if agent in _DEFAULTS:
        raise InputError(
            f"preset '{name}' trains with {kind_name(found.agent)}; leave out --agent {agent}, or the preset"
        )
    return dataclasses.replace(found, agent=make_kind("agent", agent))
