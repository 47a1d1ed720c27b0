"""Brax environments in rows of a table: where their episodes begin, and with which physics."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
from brax.envs.base import Wrapper

from pecjax.envs.task import take_configs
from pecjax.errors import InputError


class TableVmapWrapper(Wrapper):
    """Brax's `VmapWrapper` with every environment in a row of a table, by `info["config_id"]` (B,)."""

    def __init__(
        self,
        env: Any,
        table: Any,
        reset_to: Callable[[Any, Any, jax.Array], Any],
        draw: Callable[[jax.Array, int], jax.Array],
        system: Callable[[Any, Any], Any] | None = None,
    ) -> None:
        """Wraps `env`.

        Args:
            draw: (key, B) -> (B,) int32, the rows that `reset` begins with.

        Raises:
            InputError: `system` is given, and the environment has none.
        """
        super().__init__(env)
        self._table, self._reset_to, self._draw, self._system = table, reset_to, draw, system
        names = [name for name in ("sys", "_mjx_model") if hasattr(env.unwrapped, name)]
        if system is not None and not names:
            raise InputError(f"system: {type(env.unwrapped).__name__} has neither `sys` nor `_mjx_model`")
        self._name = names[0] if names else ""

    def reset(self, rng: jax.Array) -> Any:
        """First states in rows that are drawn; `rng` is a key for each environment."""
        keys = jax.vmap(jax.random.split)(rng)
        return self.reset_rows(self._draw(keys[0, 0], rng.shape[0]), keys[:, 1])

    def reset_rows(self, config_id: jax.Array, rng: jax.Array) -> Any:
        """First states in these rows, (B,) int32."""

        def reset_one(config: Any, key: jax.Array) -> Any:
            with self._under_system_of(config):
                return self._reset_to(self.env, config, key)

        state = jax.vmap(reset_one)(take_configs(self._table, config_id), rng)
        return state.replace(info=state.info | {"config_id": config_id})

    def step(self, state: Any, action: jax.Array) -> Any:
        """One step of each environment, under the system of its row."""

        def step_one(state: Any, action: jax.Array) -> Any:
            with self._under_system_of(take_configs(self._table, state.info["config_id"])):
                return self.env.step(state, action)

        return jax.vmap(step_one)(state, action)

    @contextlib.contextmanager
    def _under_system_of(self, config: Any) -> Iterator[None]:
        """Lends the environment a system for as long as it is traced."""
        if self._system is None:
            yield
            return
        env = self.env.unwrapped
        own = getattr(env, self._name)
        setattr(env, self._name, self._system(own, config))
        try:
            yield
        finally:
            setattr(env, self._name, own)
