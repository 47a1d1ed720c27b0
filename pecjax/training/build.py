"""Build: task, sampler and agent put together as the settings say."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pecjax.agents import AXIS, Agent, TrainState, device_mesh, shard
from pecjax.agents.observations import num_values
from pecjax.agents.sharding import placement
from pecjax.curriculum import Sampler
from pecjax.envs.task import EvalSet, Task, World, num_configs
from pecjax.runtime.devices import check_memory
from pecjax.training.contracts import check_contracts
from pecjax.training.settings import RunSettings, check_settings

Tree = TypeVar("Tree")


class Run(NamedTuple):
    """The parts of a run; its worlds are on all devices of the mesh.

    Attributes:
        eval_set: what policies are evaluated in; `eval_world` is the world with that table.
    """

    task: Task
    world: World
    sampler: Sampler
    agent: Agent
    mesh: Mesh
    eval_set: EvalSet
    eval_world: World

    @property
    def num_configs(self) -> int:
        """N, the number of configurations."""
        return num_configs(self.world.table)


def build(settings: RunSettings, num_devices: int, *, trains: bool = True, prepares: bool = True) -> Run:
    """Puts task, sampler and agent together, spread over devices.

    Args:
        trains: makes sure that memory can hold replay and observations; a policy that is only flown needs
            none of that.
        prepares: gets the world ready for training (`TaskSettings.for_training`), which may take long.

    Raises:
        InputError: settings are out of range or do not fit one another, the world is wrong, or memory
            cannot hold the observations or the replay.
    """
    check_settings(settings)
    task, world = settings.task.make()
    sampler = settings.sampler.make(num_configs(world.table))
    if trains and prepares:
        world = settings.task.for_training(world)
    check_contracts(settings, task, world, sampler)
    mesh = device_mesh(num_devices)
    agent = settings.agent.make(task, sampler, AXIS)
    if trains:
        check_training_memory(settings, task, agent, num_devices)
    eval_set = settings.task.eval_set(world)
    world, eval_world = on_devices(world, eval_set, mesh)
    return Run(task, world, sampler, shard(agent, mesh), mesh, eval_set, eval_world)


def check_training_memory(
    settings: RunSettings, task: Task, agent: Agent, num_devices: int, runs: int = 1
) -> None:
    """Makes sure that memory can hold what so many runs at once need of it.

    Raises:
        InputError: it cannot.
    """
    about, fewer = settings.agent, "take fewer environments or steps"
    for needed, what, advice in (
        (
            agent.replay_bytes,
            "the transitions of the replay",
            "take a smaller --agent.replay.capacity, or smaller images",
        ),
        (
            observation_bytes(task, about.observations_held),
            "the observations of an iteration",
            f"{fewer}, or smaller images",
        ),
        (about.memory_bytes, "the memories of an iteration", f"{fewer}, or a smaller memory"),
    ):
        of_runs = f" of {runs} runs at once" if runs > 1 else ""
        check_memory(needed * runs, num_devices, what + of_runs, advice)


def on_devices(world: World, eval_set: EvalSet, mesh: Mesh) -> tuple[World, World]:
    """The world, and the same with the configurations of an evaluation, on every device of the mesh."""
    there = everywhere(world, mesh)
    if eval_set.table is world.table:
        return there, there
    return there, there._replace(table=everywhere(eval_set.table, mesh))


def everywhere(tree: Tree, mesh: Mesh) -> Tree:
    """The arrays, such as those of a world, on every device of the mesh."""
    place = NamedSharding(mesh, PartitionSpec())
    if jax.process_count() == 1:
        return jax.device_put(tree, place)

    def own_copies(leaf: Any) -> jax.Array:
        array = jnp.asarray(leaf)
        return jax.make_array_from_callback(array.shape, place, lambda part: array[part])

    # `device_put` would compare all processes' copies, and one of them may not come this far.
    return jax.tree.map(own_copies, tree)


def observation_bytes(task: Task, number: int) -> int:
    """What so many observations take."""
    return 4 * num_values(task.observation_space) * number


def abstract_state(run: Run) -> TrainState:
    """Shapes and placement of a TrainState's arrays, without making any of them."""
    state = jax.eval_shape(run.agent.init, jax.random.key(0), run.world)

    def placed(part: Any, place: NamedSharding) -> Any:
        return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=place), part)

    return TrainState(*map(placed, state, placement(run.mesh)))
