"""The curriculum in the training loops of Brax, which MuJoCo Playground uses too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import Wrapper
from brax.envs.wrappers.training import EpisodeWrapper

from pecjax.curriculum.base import Outcomes, Sampler
from pecjax.curriculum.nested import num_configs_of
from pecjax.curriculum.wrappers.brax_rows import TableVmapWrapper
from pecjax.envs.task import num_configs
from pecjax.errors import InputError

AXIS = "i"  # of the devices, in every trainer of Brax
CURRICULUM = "curriculum"  # its place in `info`
# In `info`: what learners read of the step that ended an episode, though environments may have set it too.
OF_THE_STEP = frozenset({"steps", "truncation", "time_out", "episode_done", "episode_metrics"})


class CurriculumState(NamedTuple):
    """What the curriculum carries from step to step, in `info["curriculum"]`, without a batch axis.

    Attributes:
        sampler: the sampler's state, the same on all devices.
        key: for all draws, different on every device.
        step: () int32, steps since the first reset.
    """

    sampler: Any
    key: jax.Array
    step: jax.Array


def curriculum_wrap(
    sampler: Sampler,
    table: Any,
    *,
    reset_to: Callable[[Any, Any, jax.Array], Any],
    failed: Callable[[Any], jax.Array],
    system: Callable[[Any, Any], Any] | None = None,
    callback: Callable[[Any], None] | None = None,
    every: int = 1000,
) -> Callable[..., Wrapper]:
    """Makes a replacement of `brax.envs.training.wrap` that resets episodes to rows of a table.

    Every step of all environments is one batch of outcomes, with lengths and returns. In training, where
    Brax names the axis of its devices, these are summed over all of them. Brax's evaluator names no axis
    and resets before every evaluation: it flies in configurations drawn by the sampler's first state,
    uniformly as long as nothing has been tried. The training's counts do not change by it.

    `info["config_id"]` (B,) int32 is the row of the running episode. `num_resets_per_eval` above 0 makes
    Brax reset the training's environments too, and with them the sampler.

    Example:
        wrap = curriculum_wrap(pec(len(targets)), targets, reset_to=reset_to, failed=failed)
        ppo.train(env, wrap_env_fn=wrap, ...)

    Args:
        table: the N configurations, a pytree of arrays (N, ...).
        reset_to: (environment, row of the table, key) -> the first state of one episode. The environment
            is what the trainer was given.
        failed: (state) -> (B,) bool, for the batched state in which episodes end, before any reset.
        system: (system, row of the table) -> system: the physics of each configuration. Systems are the
            environment's `sys`, or Playground's `mjx_model`.
        callback: (sampler's state, of NumPy arrays) -> None; called in training by the first device. It
            runs beside the training and must not call JAX. `jax.effects_barrier()` waits for the last one.
        every: the steps between callbacks, each of all environments.

    Returns:
        (env, episode_length=1000, action_repeat=1, randomization_fn=None) -> the wrapped environment.

    Raises:
        InputError: the table and the sampler differ in size, or `every` is below 1. Raised later if
            `randomization_fn` is given too, no system is found, or `failed` returns another shape.
    """
    expected = num_configs_of(sampler)
    if num_configs(table) != expected:
        raise InputError(f"table has {num_configs(table)} rows, but the sampler {expected} configurations")
    if every < 1:
        raise InputError(f"every is {every}; give the steps between callbacks, 1 or more")

    def wrap(
        env: Any, episode_length: int = 1000, action_repeat: int = 1, randomization_fn: Any = None
    ) -> Wrapper:
        if randomization_fn is not None:
            raise InputError("randomization_fn: the table says how episodes differ; give `system` instead")

        def draw_first(key: jax.Array, number: int) -> jax.Array:
            return sampler.sample(sampler.init(), key, number)

        rows = TableVmapWrapper(env, table, reset_to, draw_first, system)
        episodes = EpisodeWrapper(rows, episode_length, action_repeat)
        return CurriculumWrapper(episodes, rows, sampler, failed, callback, every)

    return wrap


class CurriculumWrapper(Wrapper):
    """Replaces Brax's `AutoResetWrapper`: new episodes begin in rows that the sampler draws."""

    def __init__(
        self,
        env: Any,
        rows: TableVmapWrapper,
        sampler: Sampler,
        failed: Callable[[Any], jax.Array],
        callback: Callable[[Any], None] | None,
        every: int,
    ) -> None:
        """Wraps `env`, an `EpisodeWrapper` of `rows`. See `curriculum_wrap`."""
        super().__init__(env)
        self._rows, self._sampler, self._failed = rows, sampler, failed
        self._callback, self._every = callback, every

    def reset(self, rng: jax.Array) -> Any:
        """First states, and a sampler that has heard of nothing."""
        keys = jax.vmap(jax.random.split)(rng)
        state = self.env.reset(keys[:, 1])
        own = CurriculumState(self._sampler.init(), keys[0, 0], jnp.zeros((), jnp.int32))
        return state.replace(info=state.info | {CURRICULUM: own})

    def step(self, state: Any, action: jax.Array) -> Any:
        """One step. Where it ends an episode, observation and physics are those of the next one."""
        info = dict(state.info)
        own = info.pop(CURRICULUM)
        info["steps"] = jnp.where(state.done, 0.0, info["steps"])
        state = self.env.step(state.replace(info=info, done=jnp.zeros_like(state.done)), action)

        axis = _bound_axis()
        learned = self._sampler.update(own.sampler, self._outcomes(state), axis)
        key, key_ids, key_reset = jax.random.split(own.key, 3)
        own = CurriculumState(learned, key, own.step + 1)
        if self._callback is not None and axis is not None:
            _call_back(self._callback, own.step % self._every == 0, learned)

        def begin_anew(state: Any) -> Any:
            number = state.done.shape[0]
            drawn = self._sampler.sample(learned, key_ids, number)
            fresh = self._rows.reset_rows(drawn, jax.random.split(key_reset, number))
            return _replace(state, fresh)

        # Most steps of few environments end nothing, and a reset is dear.
        state = jax.lax.cond(state.done.any(), begin_anew, lambda state: state, state)
        return state.replace(info=state.info | {CURRICULUM: own})

    def _outcomes(self, state: Any) -> Outcomes:
        failed = self._failed(state)
        if jnp.shape(failed) != state.done.shape:
            raise InputError(
                f"failed gives shape {jnp.shape(failed)}; its state is batched: give {state.done.shape}"
            )
        so_far = state.info["episode_metrics"]
        return Outcomes(state.info["config_id"], state.done, failed, so_far["length"], so_far["sum_reward"])


def _call_back(callback: Callable[[Any], None], is_due: jax.Array, sampler_state: Any) -> None:
    def on_host(state: Any) -> None:
        callback(jax.tree.map(np.asarray, state))  # arrays of JAX would tempt to compute with them

    jax.lax.cond(
        is_due & (jax.lax.axis_index(AXIS) == 0),
        lambda state: jax.debug.callback(on_host, state),
        lambda state: None,
        sampler_state,
    )


def _bound_axis() -> str | None:
    try:
        jax.lax.axis_size(AXIS)
    except NameError:  # not in training
        return None
    return AXIS


def _replace(state: Any, fresh: Any) -> Any:
    """The state, but where it is done physics, observation and the environment's own `info` of `fresh`."""

    def choose(new: jax.Array, old: jax.Array) -> jax.Array:
        done = state.done.astype(bool).reshape(state.done.shape + (1,) * (old.ndim - 1))
        return jnp.where(done, new.astype(old.dtype), old)

    physics = "pipeline_state" if hasattr(state, "pipeline_state") else "data"
    info = {name: value for name, value in fresh.info.items() if name not in OF_THE_STEP}
    changed = {physics: getattr(fresh, physics), "obs": fresh.obs, "info": info}
    kept = {
        physics: getattr(state, physics),
        "obs": state.obs,
        "info": {name: state.info[name] for name in info},
    }
    merged = jax.tree.map(choose, changed, kept)
    return state.replace(**merged | {"info": state.info | merged["info"]})
