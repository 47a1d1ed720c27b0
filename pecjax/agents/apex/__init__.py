"""Ape-X DQN: distributed prioritised replay (Horgan et al. 2018)."""

from pecjax.agents.apex.settings import Apex as Apex
