"""Agents: the learners. They know tasks and samplers by their contracts only."""

from pecjax.agents.apex import Apex as Apex
from pecjax.agents.base import Agent as Agent, AgentSettings as AgentSettings, TrainState as TrainState
from pecjax.agents.metrics import Metrics as Metrics
from pecjax.agents.ppo import PPO as PPO
from pecjax.agents.sharding import AXIS as AXIS, device_mesh as device_mesh, shard as shard
