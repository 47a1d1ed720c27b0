"""The curriculum in loops over environments of gymnax, such as PureJaxRL's."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from gymnax.environments.environment import Environment  # pyright: ignore[reportMissingImports]

from pecjax.curriculum.draws import sample_ids
from pecjax.envs.task import take_configs
from pecjax.errors import InputError


class CurriculumParams(NamedTuple):
    """The params of a `Curriculum`, in place of an environment's `EnvParams`.

    Attributes:
        table: `EnvParams` whose leaves have a leading axis N; `pecjax.envs.gymnax.params_table` makes one.
        probabilities: (N,) of each row, at every reset; they need not sum to 1.
    """

    table: Any
    probabilities: jax.Array


class CurriculumState(NamedTuple):
    """An episode.

    Attributes:
        state: the environment's own.
        config_id: () int32, its row of the table.
        length: () int32, actions so far.
        episode_return: () float32, rewards so far.
    """

    state: Any
    config_id: jax.Array
    length: jax.Array
    episode_return: jax.Array


class Curriculum(Environment):
    """An environment of gymnax 1.0 or later whose every episode is in a newly drawn configuration.

    It is a gymnax environment too: `reset` and `step` have gymnax's signature, and gymnax's wrappers can go
    around it. Batch it by `jax.vmap` with the params unbatched. The sampler stays outside; its
    probabilities are renewed once a batch:

        env = Curriculum(env)
        params = CurriculumParams(table, sampler.probabilities(state))
        ...  # a batch of steps under these params
        state = sampler.update(state, Outcomes(info["config_id"], done, failed))

    A step's `info` gains what `Outcomes` needs about the episode of that step, its last step included:
    `config_id`, `episode_length` and `episode_return`.
    """

    def __init__(self, env: Any) -> None:
        """Wraps `env`.

        Raises:
            InputError: a wrapper, or no environment of gymnax. A wrapper has a state of its own, which would
                not be reset.
        """
        if not isinstance(env, Environment):
            raise InputError(
                f"Curriculum wraps an environment of gymnax itself, and this is a {type(env).__name__}; "
                "put wrappers around Curriculum"
            )
        self._env = env

    @property
    def default_params(self) -> CurriculumParams:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A table of one row, the environment's own default."""
        table = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], self._env.default_params)
        return CurriculumParams(table, jnp.ones(1))

    def reset_env(self, key: jax.Array, params: CurriculumParams) -> tuple[Any, CurriculumState]:
        """The first observation and state of an episode in a row that is drawn here.

        Raises:
            InputError: the params are not `CurriculumParams`, or the number of probabilities is wrong.
        """
        key_row, key_reset = jax.random.split(key)
        _check(params)
        config_id = sample_ids(params.probabilities, key_row)
        obs, state = self._env.reset_env(key_reset, take_configs(params.table, config_id))
        return obs, CurriculumState(state, config_id, jnp.zeros((), jnp.int32), jnp.zeros(()))

    def step_env(
        self, key: jax.Array, state: CurriculumState, action: Any, params: CurriculumParams
    ) -> tuple[Any, CurriculumState, jax.Array, jax.Array, dict[Any, Any]]:
        """A step in the episode's own row, without the automatic reset."""
        row = take_configs(params.table, state.config_id)
        obs, after, reward, terminated, info = self._env.step_env(key, state.state, action, row)
        total = state.episode_return + jnp.asarray(reward, jnp.float32)
        state = CurriculumState(after, state.config_id, state.length + 1, total)
        told = {"config_id": state.config_id, "episode_length": state.length, "episode_return": total}
        return obs, state, reward, terminated, {**info, **told}

    def observe(self, key: jax.Array, state: CurriculumState, action: Any, params: CurriculumParams) -> Any:
        """The observation of a state, as the environment has it."""
        return self._env.observe(key, state.state, action, take_configs(params.table, state.config_id))

    def is_truncated(self, state: CurriculumState, params: CurriculumParams) -> jax.Array:
        """Whether the time limit of the episode's own row is reached."""
        return self._env.is_truncated(state.state, take_configs(params.table, state.config_id))

    def is_terminated(self, state: CurriculumState, params: CurriculumParams) -> jax.Array:
        """Whether the episode is over by the rules of its own row."""
        return self._env.is_terminated(state.state, take_configs(params.table, state.config_id))

    @property
    def name(self) -> str:
        """The environment's name."""
        return self._env.name

    @property
    def num_actions(self) -> int:
        """How many actions there are."""
        return self._env.num_actions

    def action_space(self, params: CurriculumParams) -> Any:
        """The environment's own, in the first row."""
        return self._env.action_space(take_configs(params.table, 0))

    def observation_space(self, params: CurriculumParams) -> Any:
        """The environment's own, in the first row; bounds that depend on the params hold there."""
        return self._env.observation_space(take_configs(params.table, 0))


def _check(params: Any) -> None:
    if not isinstance(params, CurriculumParams):
        raise InputError(
            f"Curriculum is reset with {type(params).__name__}; give CurriculumParams(table, probabilities)"
        )
    sizes = {jnp.shape(leaf)[:1] for leaf in jax.tree.leaves(params.table)}
    if sizes != {jnp.shape(params.probabilities)}:
        raise InputError(
            f"CurriculumParams: probabilities have shape {jnp.shape(params.probabilities)} and the leaves of "
            f"the table begin with {sorted(sizes)}; give a probability for each row"
        )
