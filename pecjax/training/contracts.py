"""Contracts: what a task and a sampler give, looked at by shape and type before anything is compiled.

Whoever plugs in one of their own hears here what is wrong with it, not from the middle of a compiled loop.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.agents import AgentSettings
from pecjax.curriculum import Outcomes, Sampler
from pecjax.envs.spaces import Box
from pecjax.envs.task import Reduction, Task, Transition, World, num_configs, take_configs
from pecjax.errors import InputError
from pecjax.settings_tree import address
from pecjax.training.settings import RunSettings

# What tables and files of flights have of every task; a metric of that name would take its place.
_TAKEN = {
    *("iteration", "env_steps", "seconds", "episodes", "goal_ratio", "training_goal_ratio", "cvar"),
    *("unbiased_cvar", "spl", "mean_return", "mean_length", "return", "length", "success", "interval"),
    *("steps_to_goal", "config_id", "recorded", "poses", "actions"),
}
_BATCH = 3  # outcomes and draws that a sampler is tried with


def check_contracts(settings: RunSettings, task: Task, world: World, sampler: Sampler) -> None:
    """Checks the task and the sampler where they are of the user's own, and that the agent suits the latter.

    Those of pecjax are held to the same by its tests, and tracing the rooms would take a second.

    Raises:
        InputError: see `check_task`, `check_sampler` and `check_signal`.
    """
    if not _is_ours(settings.task):
        check_task(task, world)
    if not _is_ours(settings.sampler):
        check_sampler(sampler, address(type(settings.sampler)), num_configs(world.table))
    check_signal(settings.agent, sampler)


def check_signal(agent: AgentSettings, sampler: Sampler) -> None:
    """Makes sure that the sampler can do without a signal where the agent gives none.

    Raises:
        InputError: it cannot.
    """
    if not agent.gives_signal:
        jax.eval_shape(sampler.update, jax.eval_shape(sampler.init), _outcomes()._replace(signal=None))


def _is_ours(tree: Any) -> bool:
    """Whether all kinds in a tree of settings come with pecjax."""
    if not dataclasses.is_dataclass(tree):
        return True
    own = type(tree).__module__.partition(".")[0] == "pecjax"
    return own and all(_is_ours(getattr(tree, field.name)) for field in dataclasses.fields(tree))


def check_task(task: Task, world: World) -> None:
    """Makes sure that a task gives what its spaces, its metrics and `Task` promise.

    Raises:
        InputError: the first thing that it does not.
    """
    name = address(type(task))
    for part in ("observation_space", "action_space", "max_steps"):
        if not hasattr(task, part):
            raise InputError(f"{name}: has no {part}; set it (see pecjax.Task)")
    if not (isinstance(task.max_steps, int | np.integer) and task.max_steps >= 1):
        raise InputError(f"{name}: max_steps is {task.max_steps}; give a whole number of 1 or more")
    lengths = sorted({jnp.shape(leaf)[:1] for leaf in jax.tree.leaves(world.table)})
    if len(lengths) != 1 or not lengths[0]:
        raise InputError(f"{name}: the table's leaves have leading axes {lengths}; give all of them one, N")
    unknown = {how for how in task.metrics.values() if how not in get_args(Reduction)}
    if unknown:
        raise InputError(
            f"{name}: metrics has {sorted(map(str, unknown))}; a metric is one of {get_args(Reduction)}"
        )
    if taken := _TAKEN & set(task.metrics):
        raise InputError(f"{name}: metrics has {', '.join(sorted(taken))}, which every task has; rename it")
    key = jax.eval_shape(lambda: jax.random.key(0))
    state, transition, obs = jax.eval_shape(functools.partial(_first_step, task), key, world)
    _expect(f"{name}: observe", obs, _as_arrays(task.observation_space), "observation_space", types=False)
    if task.privileged_space is not None:
        known = jax.eval_shape(task.privileged, state, world.params)
        promised = _as_arrays(task.privileged_space)
        _expect(f"{name}: privileged", known, promised, "privileged_space", types=False)
    if not isinstance(transition, Transition):
        raise InputError(f"{name}: step gives {type(transition).__name__}; give a Transition")
    _expect(f"{name}: the state after step", transition.state, state, "the state of reset")
    flag = _array((), jnp.bool_)
    for part, promised in (
        ("reward", _array(())),
        ("terminated", flag),
        ("truncated", flag),
        ("success", flag),
    ):
        _expect(f"{name}: {part}", getattr(transition, part), promised, "Transition")
    metrics = dict.fromkeys(task.metrics, _array(()))
    _expect(f"{name}: the metrics of step", transition.metrics, metrics, "Task.metrics", types=False)


def _first_step(task: Task, key: jax.Array, world: World) -> tuple[Any, Transition, Any]:
    state = task.reset(key, take_configs(world.table, 0), world.params)
    space = task.action_space
    shape, dtype = (space.shape, jnp.float32) if isinstance(space, Box) else ((), jnp.int32)
    transition = task.step(key, state, jnp.zeros(shape, dtype), world.params)
    return state, transition, task.observe(key, state, world.params)


def check_sampler(sampler: Sampler, name: str, num_configs: int) -> None:
    """Makes sure that a sampler over N configurations draws, weighs and keeps what `Sampler` promises.

    Args:
        name: for messages.

    Raises:
        InputError: the first thing that it does not.
    """
    key = jax.eval_shape(lambda: jax.random.key(0))
    state = jax.eval_shape(sampler.init)
    ids = jax.eval_shape(lambda state, key: sampler.sample(state, key, (_BATCH,)), state, key)
    _expect(f"{name}: sample", ids, _array((_BATCH,), jnp.int32), "Sampler.sample of that shape")
    weights = jax.eval_shape(sampler.probabilities, state)
    _expect(f"{name}: probabilities", weights, _array((num_configs,)), "N configurations")
    after = jax.eval_shape(sampler.update, state, _outcomes())
    _expect(f"{name}: the state after update", after, state, "the state of init")


def _outcomes() -> Outcomes:
    flags, number = jnp.zeros(_BATCH, bool), jnp.zeros(_BATCH)
    return Outcomes(jnp.zeros(_BATCH, jnp.int32), flags, flags, flags.astype(jnp.int32), number, number)


def _array(shape: tuple[int, ...], dtype: Any = jnp.float32) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, dtype)


def _as_arrays(space: Any) -> Any:
    return jax.tree.map(lambda box: _array(box.shape), space)


def _expect(what: str, given: Any, promised: Any, by: str, types: bool = True) -> None:
    """Raises InputError where a tree differs from the one that was promised, in structure, shape or type."""
    there, here = jax.tree.structure(given), jax.tree.structure(promised)
    if there != here:
        raise InputError(f"{what} is a tree {there} where {by} says {here}; give the same")
    for (path, one), other in zip(
        jax.tree_util.tree_leaves_with_path(given), jax.tree.leaves(promised), strict=True
    ):
        if one.shape != other.shape or (types and one.dtype != other.dtype):
            place = jax.tree_util.keystr(path)
            shown = [f"{x.shape} {x.dtype}" if types else f"{x.shape}" for x in (one, other)]
            raise InputError(f"{what}{place} is {shown[0]} where {by} says {shown[1]}; give the same")
