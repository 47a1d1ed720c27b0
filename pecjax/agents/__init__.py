"""Agents: who learns."""

from pecjax.agents import apex as apex, ppo as ppo
from pecjax.agents.agent import (
    AXIS as AXIS,
    Agent as Agent,
    Metrics as Metrics,
    TrainState as TrainState,
    fleet_mesh as fleet_mesh,
    shard as shard,
)
