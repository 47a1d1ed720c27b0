"""PPO: proximal policy optimisation (Schulman et al. 2017)."""

from pecjax.agents.ppo.settings import PPO as PPO
