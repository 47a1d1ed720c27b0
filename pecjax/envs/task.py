"""The task's contract: one environment whose episodes are each in a configuration."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.spaces import Box, Discrete
from pecjax.errors import InputError

Reduction = Literal["last", "sum", "mean", "min", "max"]


class Transition(NamedTuple):
    """What an action led to.

    Attributes:
        state: the next state.
        reward: () float32.
        terminated: () bool, the episode is over, and nothing is worth anything beyond.
        truncated: () bool, the episode is cut off; a learner bootstraps from `observe(state)`. Where
            both are true the episode is terminated.
        success: () bool, whether the episode has succeeded; read where it ends.
        metrics: () each, by the names in `Task.metrics`.
    """

    state: Any
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    success: jax.Array
    metrics: dict[str, jax.Array]


class World(NamedTuple):
    """Device arrays that are an argument of every program: others of the same shapes compile nothing.

    Attributes:
        params: what all episodes share, a pytree: maps, weights of the reward, …
        table: the configurations, a pytree whose leaves have a leading axis N.
    """

    params: Any
    table: Any


class EvalSet(NamedTuple):
    """The configurations that policies are compared in, apart from those they are trained in.

    Attributes:
        table: a table like the world's, E configurations; the world's own where policies are compared in
            what they are trained in.
        groups: names of the groups that are reported apart; with one there is nothing to report apart.
        group_id: (E,) int, the group of each configuration; None where there is one group.
        shortest: (E,) m, the length of the shortest path that succeeds; None where it is not known.
        held_out: whether no training draws from it.
    """

    table: Any
    groups: tuple[str, ...] = ("all",)
    group_id: np.ndarray | None = None
    shortest: np.ndarray | None = None
    held_out: bool = False


class Task(abc.ABC):
    """One environment; who uses it batches it by `jax.vmap`.

    States are pytrees. A task never resets itself, keeps all its counters in the state, and takes what
    is large, such as maps, from `params` whenever it needs it: states are copied where episodes end.

    Attributes:
        observation_space: a `Box`, or a tree of them.
        action_space: `Discrete`, or a `Box` of finite bounds.
        privileged_space: of what `privileged` gives, a `Box` or a tree of them; None where it gives nothing.
        max_steps: the most actions that an episode may take. The task itself ends it then.
        truncates: whether `truncated` is ever true. Otherwise the observation an episode ends with is
            never computed.
        metrics: figures of an episode by name, and how its steps are put together. They become columns
            of metrics.csv and evaluation.csv, as means over the episodes that ended.
    """

    observation_space: Any
    action_space: Box | Discrete
    privileged_space: Any = None
    max_steps: int
    truncates: bool = False
    metrics: ClassVar[Mapping[str, Reduction]] = {}

    @abc.abstractmethod
    def reset(self, key: jax.Array, config: Any, params: Any) -> Any:
        """The first state of an episode in `config`, one row of the table."""

    @abc.abstractmethod
    def step(self, key: jax.Array, state: Any, action: jax.Array, params: Any) -> Transition:
        """One action. What follows an ending is undefined."""

    @abc.abstractmethod
    def observe(self, key: jax.Array, state: Any, params: Any) -> Any:
        """What the policy is given, scaled for networks: most of it between -1 and 1."""

    def privileged(self, state: Any, params: Any) -> Any:
        """What a critic may be given of the state beside what is observed, scaled likewise.

        It is for training alone: no policy is shown it (Pinto et al. 2018, "Asymmetric actor critic for
        image-based robot learning").
        """
        # Not abstract, as most tasks tell critics nothing: it is called only with a `privileged_space`.
        raise InputError(f"{type(self).__name__} has a privileged_space; write `privileged`, too")

    def fitted(self, table: Any) -> Any:
        """A table of other configurations as this task flies it.

        Raises:
            InputError: it cannot, since a policy of this task would be shown something else.
        """
        return table

    def pose(self, state: Any) -> jax.Array | None:
        """Position m and attitude quaternion w-x-y-z, (7,), where there is a map to draw it on; else None."""
        return None


@dataclass(frozen=True)
class TaskSettings(abc.ABC):
    """A kind of task with its numbers: extend it by a frozen dataclass, and a run can name it.

    `pecjax.envs.rooms.settings.Rooms` is one; `examples/own_task.py` shows one in a file of its own.
    """

    @abc.abstractmethod
    def make(self) -> tuple[Task, World]:
        """The task and its world, checked against one another.

        Raises:
            InputError: anything that a user can put right.
        """

    def for_training(self, world: World) -> World:
        """The world with what only training needs, such as what critics are told of."""
        return world

    def eval_set(self, world: World) -> EvalSet:
        """What its policies are evaluated in: all of the world's configurations, unless it says otherwise."""
        return EvalSet(world.table)

    def files(self) -> dict[str, bytes]:
        """The files that it reads, by name, to be kept in a run's folder."""
        return {}

    def kept_in(self, folder: Path) -> TaskSettings:
        """The same settings, but reading the files that are kept in `folder`."""
        return self

    def notices(self, task: Task, world: World) -> tuple[str, ...]:
        """A line for each thing that is allowed, but seldom meant."""
        return ()


def num_configs(table: Any) -> int:
    """N, the number of configurations of a table."""
    return jax.tree.leaves(table)[0].shape[0]


def take_configs(table: Any, ids: Any) -> Any:
    """The configurations of these numbers: a row where `ids` is a scalar, else a table."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[ids], table)
