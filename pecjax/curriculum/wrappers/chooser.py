"""A sampler on the host, for loops that are not JAX programs: NumPy's, PyTorch's, Gymnasium's."""

from __future__ import annotations

import os
from collections.abc import Mapping
from copy import copy
from typing import Any

import jax
import numpy as np

from pecjax.curriculum.base import Outcomes, Sampler, check_outcomes
from pecjax.curriculum.nested import num_configs_of
from pecjax.errors import InputError


class Chooser:
    """Holds a sampler's state, draws configurations and takes their outcomes, all on the CPU.

    Example:
        chooser = Chooser(pec(50), {"length": np.linspace(0.2, 2.0, 50)})
        ids = chooser.sample(8)
        env.reset(options=chooser.row(ids[0]))
        ...
        chooser.update(Outcomes(ids, done, failed))

    Save and restore `state` and `draws` to checkpoint it.

    It works only in the process that made it: a copy in another process would keep its own counts.

    Attributes:
        sampler: the sampler whose state it holds.
        num_configs: N.
        draws: int, how often it has drawn. With the seed it determines the next draw.
    """

    def __init__(self, sampler: Sampler, table: Mapping[str, Any], seed: int = 0) -> None:
        """Starts with the sampler's first state.

        Args:
            table: the configurations by name, arrays with a leading axis N: what `reset(options=…)` takes.
            seed: of all draws.

        Raises:
            InputError: the table's arrays differ in length or do not fit the sampler.
        """
        self._process = os.getpid()
        self._cpu = jax.local_devices(backend="cpu")[0]
        self.sampler = sampler
        self._state = jax.device_put(sampler.init(), self._cpu)
        self.num_configs = num_configs_of(sampler)
        self._table = {name: np.asarray(values) for name, values in table.items()}
        for name, values in self._table.items():
            if values.shape[:1] != (self.num_configs,):
                raise InputError(
                    f"table: {name} has shape {values.shape}; give it a leading axis of the sampler's "
                    f"{self.num_configs} configurations"
                )
        self.draws = 0
        key = jax.device_put(jax.random.key(seed), self._cpu)

        def sample(state: Any, draws: int, shape: int) -> jax.Array:
            return sampler.sample(state, jax.random.fold_in(key, draws), shape)

        self._sample = jax.jit(sample, static_argnums=2)
        self._update = jax.jit(lambda state, outcomes: sampler.update(state, outcomes))

    @property
    def state(self) -> Any:
        """The sampler's state, a pytree of arrays.

        Raises:
            InputError: it is set to a state of another sampler.
        """
        return self._state

    @state.setter
    def state(self, state: Any) -> None:
        if _shapes(state) != _shapes(self._state):
            raise InputError(
                f"state: it is not one of a sampler like this over {self.num_configs} configurations"
            )
        self._state = jax.device_put(state, self._cpu)

    def sample(self, number: int) -> np.ndarray:
        """Draws configurations: (number,) int32.

        Raises:
            InputError: this is not the process that made it.
        """
        self._check_process()
        self.draws += 1
        return np.asarray(self._sample(self._state, self.draws, number))

    def update(self, outcomes: Outcomes) -> None:
        """Updates the sampler with the outcomes of some episodes.

        Raises:
            InputError: impossible outcomes, or another process.
        """
        self._check_process()
        counted = check_outcomes(outcomes, self.num_configs)
        others = (None if part is None else np.asarray(part) for part in outcomes[3:])
        self._state = self._update(self._state, Outcomes(*counted, *others))

    def row(self, config_id: int) -> dict[str, Any]:
        """One configuration by name: Python's numbers, and arrays where a row of the table is one."""
        picked = {name: values[config_id] for name, values in self._table.items()}
        return {
            name: value.item() if isinstance(value, np.generic) else copy(value)
            for name, value in picked.items()
        }

    def _check_process(self) -> None:
        if os.getpid() != self._process:
            raise InputError(_ONE_PROCESS)

    def __reduce__(self) -> Any:
        raise InputError(_ONE_PROCESS)


_ONE_PROCESS = (
    "a Chooser works in the process that made it; with environments in processes of their own, use "
    "CurriculumVectorWrapper around AsyncVectorEnv (in Stable-Baselines3: DummyVecEnv)"
)


def _shapes(state: Any) -> Any:
    leaves, structure = jax.tree.flatten(state)
    return [np.shape(leaf) for leaf in leaves], structure
