"""An environment of Gymnasium whose episodes are known beforehand; light, for processes of its own."""

from typing import ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces


class Countdown(gymnasium.Env):
    """Lasts for as many steps as `reset` is told, and then ends as it is told: by a fall, or out of time.

    It shows how many steps there have been, and from where it counted.
    """

    metadata: ClassVar = {"render_modes": []}

    def __init__(self, extra=0, default=None):
        self.extra, self.default = extra, default
        self.observation_space = spaces.Box(-100, 100, (2,), np.float32)
        self.action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        options = options or self.default
        assert type(options["length"]) is int and type(options["falls"]) is bool
        self.length, self.falls, self.steps = options["length"] + self.extra, options["falls"], 0
        self.start = options["start"].copy()
        return self._obs(), {"begun": self.np_random.integers(100)}

    def step(self, action):
        self.steps += 1
        over = self.steps >= self.length
        info = {"steps": self.steps, "over": over} | ({"why": "fell"} if over and self.falls else {})
        return self._obs(), float(action), over and self.falls, over and not self.falls, info

    def _obs(self):
        return np.array([self.steps, self.start.sum()], np.float32)
