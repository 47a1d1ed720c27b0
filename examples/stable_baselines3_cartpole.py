"""Stable-Baselines3's PPO over CartPoles of many lengths; PEC chooses the pole of each next episode.

    python examples/stable_baselines3_cartpole.py    (after pip install -e ".[stable-baselines3]")

All environments are in this process, as `make_vec_env` has them, and share one chooser.
"""

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from pecjax.curriculum import pec
from pecjax.curriculum.wrappers.chooser import Chooser
from pecjax.curriculum.wrappers.gymnasium import CurriculumWrapper

LENGTH = np.geomspace(0.1, 2.5, 12)


class Pole(gym.Wrapper):
    """CartPole whose `reset` takes the length of the pole; so other physics can be read from options too."""

    def reset(self, *, seed=None, options=None):
        """An episode with a pole of `options["length"]`, from its middle to its end (m)."""
        pole = self.unwrapped
        pole.length = options["length"]
        pole.polemass_length = pole.masspole * pole.length
        return self.env.reset(seed=seed)


def main(num_steps=300_000, num_envs=8):
    """Trains and prints how often each pole fell; returns each (config_id, fell), and the chooser."""
    chooser, ended = Chooser(pec(len(LENGTH)), {"length": LENGTH}), []

    def failed(reward, terminated, truncated, info):
        ended.append((info["config_id"], terminated))
        return terminated

    def one():
        return CurriculumWrapper(Pole(gym.make("CartPole-v1")), chooser, failed=failed)

    envs = make_vec_env(one, n_envs=num_envs, seed=0)
    PPO("MlpPolicy", envs, n_steps=256, batch_size=256, seed=0, device="cpu").learn(num_steps)
    late = ended[-len(ended) // 4 :]
    for n, length in enumerate(LENGTH):
        falls = [fell for config_id, fell in late if config_id == n]
        print(f"a pole of {length:.2f} m fell in {sum(falls)} of its last {len(falls)} episodes")
    return ended, chooser


if __name__ == "__main__":
    main()
