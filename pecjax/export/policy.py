"""The policy that is exported: the network of a run, as a function of named inputs."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.agents import PPO, Apex
from pecjax.agents.apex.agent import make_network as make_q_network
from pecjax.agents.apex.q_network import QNetwork, action_values
from pecjax.agents.distributions import make_distribution
from pecjax.agents.networks import ActorCritic, decide
from pecjax.agents.observations import encode, pack, unpack
from pecjax.agents.ppo.agent import make_network as make_actor_critic
from pecjax.envs.spaces import Box, Discrete
from pecjax.errors import InputError
from pecjax.training.kinds import kind_name
from pecjax.training.load import Trained

ACTION = "action"  # an output
MEMORY, MEMORY_AFTER = "memory", "memory_after"  # an input and an output, where the network has a memory


class Policy(NamedTuple):
    """A trained network without what trained it.

    Attributes:
        observation_space, action_space: the task's.
        network: of actor and critic, or of action values.
        params: the network's, as NumPy arrays.
        names: of the inputs, one for each leaf of the observation space in the order of its tree.
        output: the name of what the network puts out: logits, parameters (of a distribution) or q_values.
        memory: what it carries from step to step; None of a network without memory.
    """

    observation_space: Any
    action_space: Box | Discrete
    network: ActorCritic | QNetwork
    params: Any
    names: tuple[str, ...]
    output: str
    memory: Box | None = None

    @property
    def inputs(self) -> dict[str, Box]:
        """The boxes of the observation by name, and the memory's."""
        boxes = dict(zip(self.names, jax.tree.leaves(self.observation_space), strict=True))
        return boxes if self.memory is None else boxes | {MEMORY: self.memory}


def policy_of(trained: Trained) -> Policy:
    """The policy of a run.

    Raises:
        InputError: of an agent whose network is not one of ours, or of observations that cannot be named.
    """
    task, agent = trained.run.task, trained.settings.agent
    if type(agent) is PPO:
        network = make_actor_critic(task, agent)
        output = "logits" if isinstance(task.action_space, Discrete) else "parameters"
    elif type(agent) is Apex:
        network, output = make_q_network(task, agent), "q_values"
    else:
        raise InputError(
            f"the agent {kind_name(agent)} cannot be exported; only policies of ppo and apex can"
        )
    names = input_names(task.observation_space)
    for name in names:
        if names.count(name) > 1 or name in (output, ACTION, MEMORY, MEMORY_AFTER):
            raise InputError(f"the observation '{name}' has the name of another input or output; rename it")
    params = jax.tree.map(np.asarray, trained.learner.params)
    first = trained.run.agent.first_memory
    memory = None if first is None else Box(first.shape)
    return Policy(task.observation_space, task.action_space, network, params, names, output, memory)


def input_names(space: Any) -> tuple[str, ...]:
    """A name for each leaf of an observation space: its keys with dots between.

    A lone box is the `observation`.
    """
    paths = [path for path, _ in jax.tree_util.tree_flatten_with_path(space)[0]]
    return tuple(jax.tree_util.keystr(path, simple=True, separator=".") or "observation" for path in paths)


def evaluate(policy: Policy, inputs: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """What the network puts out for inputs (B, …), and the greedy action: (B,) int32, or (B, A).

    And the memory after the step, where the network has one.
    """
    space = policy.observation_space
    obs = jax.tree.unflatten(jax.tree.structure(space), [inputs[name] for name in policy.names])
    if isinstance(policy.network, QNetwork):
        values = action_values(policy.network, policy.params, unpack(space, pack(space, obs)))
        return {policy.output: values, ACTION: jnp.argmax(values, axis=-1).astype(jnp.int32)}
    distribution = make_distribution(policy.action_space)
    out = decide(policy.network, policy.params, encode(space, obs), inputs.get(MEMORY))
    outputs = {policy.output: out.params, ACTION: distribution.action(distribution.mode(out.params))}
    return outputs if out.memory is None else outputs | {MEMORY_AFTER: out.memory}
