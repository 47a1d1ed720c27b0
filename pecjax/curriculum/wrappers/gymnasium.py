"""The curriculum in loops over environments of Gymnasium, and so in Stable-Baselines3.

A configuration is passed as `reset(options=…)`: a row of a table of arrays by name. For environments with
physics of their own, a `gymnasium.Wrapper` of a few lines reads the options in `reset`
(`examples/stable_baselines3_cartpole.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import iterate

from pecjax.curriculum.base import Outcomes, Sampler
from pecjax.curriculum.wrappers.chooser import Chooser
from pecjax.errors import InputError

# (reward, terminated, truncated, info) of the last step of an episode -> whether it failed
Failed = Callable[[float, bool, bool, dict[str, Any]], Any]


class CurriculumWrapper(gymnasium.Wrapper):
    """One environment, each of whose episodes is in a configuration that a chooser draws.

    Several in one process share one chooser, as in Stable-Baselines3:

        chooser = Chooser(pec(50), {"length": np.linspace(0.2, 2.0, 50)})
        envs = make_vec_env(lambda: CurriculumWrapper(gym.make(…), chooser, failed=…), n_envs=8)

    `info` gains `config_id`, the configuration of the episode that it belongs to. An episode that a reset
    cuts short does not count.
    """

    def __init__(self, env: gymnasium.Env, chooser: Chooser, *, failed: Failed) -> None:
        """Wraps `env`.

        Args:
            failed: (reward, terminated, truncated, info) of an episode's last step -> whether it failed.
        """
        super().__init__(env)
        self.chooser = chooser
        self._failed = failed

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in a configuration drawn here, which goes before equal names in `options`."""
        self._config_id = self.chooser.sample(1)
        row = self.chooser.row(self._config_id[0])
        self._length, self._return = 0, 0.0
        observation, info = self.env.reset(seed=seed, options={**(options or {}), **row})
        return observation, self._told(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One step; after an episode's last step the chooser gets its outcome.

        Raises:
            InputError: `failed` says neither true nor false.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        info = self._told(info)
        self._length += 1
        self._return += float(reward)
        if terminated or truncated:
            failed = self._failed(float(reward), terminated, truncated, info)
            self.chooser.update(Outcomes(self._config_id, [True], [failed], [self._length], [self._return]))
        return observation, reward, terminated, truncated, info

    def _told(self, info: dict[str, Any]) -> dict[str, Any]:
        return {**info, "config_id": int(self._config_id[0])}


class CurriculumVectorWrapper(VectorWrapper):
    """Environments side by side, each of whose episodes is in a configuration that a sampler draws.

    For `SyncVectorEnv` and `AsyncVectorEnv` that do not reset by themselves. The wrapper resets ended
    episodes within the same step, as `AutoresetMode.SAME_STEP` does. Other vector wrappers go around it.

        envs = gym.make_vec(…, vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED})
        envs = CurriculumVectorWrapper(envs, pec(50), {"length": np.linspace(0.2, 2.0, 50)}, failed=…)

    `infos["config_id"]` is the configuration of the episode that the observation belongs to; of an episode
    that ended it is in `infos["final_info"]`, and the last observation in `infos["final_obs"]`.

    JAX warns of processes that are forked after it has started: give `AsyncVectorEnv` the context "spawn" or
    "forkserver".

    Attributes:
        chooser: the sampler's state, the same for all environments.
    """

    def __init__(
        self, envs: VectorEnv, sampler: Sampler, table: Mapping[str, Any], *, failed: Failed, seed: int = 0
    ) -> None:
        """Wraps `envs`.

        Args:
            table: the configurations by name, arrays with a leading axis N: what `reset(options=…)` takes.
            failed: (reward, terminated, truncated, info) of an episode's last step -> whether it failed.
            seed: of the draws of configurations.

        Raises:
            InputError: environments that reset by themselves, or a table that does not fit the sampler.
        """
        super().__init__(envs)
        # Environments of one class share their metadata, in which the newest has the last word.
        mode = getattr(envs.unwrapped, "autoreset_mode", envs.metadata.get("autoreset_mode"))
        if mode is not AutoresetMode.DISABLED:
            raise InputError(
                f"CurriculumVectorWrapper: with autoreset mode {getattr(mode, 'name', mode)} environments "
                "reset without a configuration; make them with autoreset_mode=AutoresetMode.DISABLED"
            )
        self.metadata = {**envs.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.chooser = Chooser(sampler, table, seed)
        self._failed = failed

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode everywhere; the configurations go before equal names in `options`.

        Raises:
            InputError: `options` has a `reset_mask`; what has ended is reset within `step`.
        """
        options = dict(options or {})
        if "reset_mask" in options:
            raise InputError("reset: options has a reset_mask; what has ended is reset within the step")
        self._config_id = self.chooser.sample(self.num_envs)
        self._length, self._return = np.zeros(self.num_envs, int), np.zeros(self.num_envs)
        # The first reset has to be one of all at once.
        row = self.chooser.row(self._config_id[0])
        observations, infos = self.env.reset(seed=seed, options={**options, **row})
        told = [_info_of(infos, n) for n in range(self.num_envs)]
        others = self._config_id != self._config_id[0]
        if others.any():
            observations = self._begin(others, told, options)
        return observations, self._batched(told)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step everywhere; the sampler gets the outcomes of ended episodes and draws the next ones.

        Raises:
            InputError: `failed` says neither true nor false.
        """
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        self._length += 1
        self._return += rewards
        told = [_info_of(infos, n) for n in range(self.num_envs)]
        ended = np.logical_or(terminated, truncated)
        last: dict[int, dict[str, Any]] = {}
        if ended.any():
            failed = [False] * self.num_envs
            for n, observation in enumerate(iterate(self.observation_space, observations)):
                if ended[n]:
                    own = {**told[n], "config_id": self._config_id[n]}
                    last[n] = {"final_obs": deepcopy(observation), "final_info": own}
                    failed[n] = self._failed(float(rewards[n]), bool(terminated[n]), bool(truncated[n]), own)
            self.chooser.update(Outcomes(self._config_id, ended, failed, self._length, self._return))
            self._config_id = np.where(ended, self.chooser.sample(self.num_envs), self._config_id)
            self._length[ended], self._return[ended] = 0, 0.0
            observations = self._begin(ended, told, {})
        return observations, rewards, terminated, truncated, self._batched(told, last)

    def _begin(self, where: np.ndarray, told: list[dict[str, Any]], options: dict[str, Any]) -> Any:
        """Begins an episode in these environments, and puts what they tell into `told`."""
        observations = None
        for config_id in np.unique(self._config_id[where]):
            mask = where & (self._config_id == config_id)
            row = self.chooser.row(config_id)
            observations, infos = self.env.reset(options={**options, **row, "reset_mask": mask.copy()})
            for n in np.flatnonzero(mask):
                told[n] = _info_of(infos, n)
        return observations

    def _batched(self, told: list[dict[str, Any]], last: Mapping[int, dict[str, Any]] = {}) -> dict[str, Any]:
        """The infos of all as Gymnasium's vector environments give them."""
        infos: dict[str, Any] = {}
        for n, info in enumerate(told):
            own = {**info, "config_id": self._config_id[n]}
            infos = self._add_info(self._add_info(infos, last.get(n, {}), n), own, n)
        return infos


def _info_of(infos: dict[str, Any], n: Any) -> dict[str, Any]:
    """What a vector environment's infos say of one environment."""
    own = {}
    for name, value in infos.items():
        if name.startswith("_") or not infos.get(f"_{name}", np.ones(n + 1))[n]:
            continue
        own[name] = _info_of(value, n) if isinstance(value, dict) else value[n]
        if isinstance(own[name], np.bool_):  # which Gymnasium batches as objects
            own[name] = bool(own[name])
    return own
