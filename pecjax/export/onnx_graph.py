"""The policy as an ONNX graph, built layer by layer from the network's parameters."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

import pecjax
from pecjax.agents.apex.q_network import QNetwork
from pecjax.agents.convolutions import CONVOLUTIONS
from pecjax.agents.observations import LEVELS, in_order, is_byte
from pecjax.envs.spaces import Box, Discrete
from pecjax.export.policy import ACTION, MEMORY, MEMORY_AFTER, Policy

# What runtimes of the last years read; the graph needs nothing newer.
OPSET, IR_VERSION = 17, 8


class Graph:
    """Nodes and weights that are added one after another; each is known by the name of its result."""

    def __init__(self) -> None:
        """Empty."""
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def add(self, op: str, *inputs: str, name: str | None = None, **attributes: Any) -> str:
        """Adds a node of one output; returns its name."""
        from onnx import helper

        name = name or f"/{op}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(op, list(inputs), [name], **attributes))
        return name

    def weight(self, value: Any, dtype: Any = np.float32) -> str:
        """Adds a constant; returns its name."""
        from onnx import numpy_helper

        name = f"/weight_{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(value, dtype), name))
        return name

    def dense(self, x: str, layer: dict[str, np.ndarray], columns: slice = slice(None)) -> str:
        """A layer (B, F) -> (B, its columns)."""
        return self.add(
            "Gemm", x, self.weight(layer["kernel"][:, columns]), self.weight(layer["bias"][columns])
        )


def onnx_model(policy: Policy) -> bytes:
    """The serialized model, checked by ONNX itself; its batch may be of any size."""
    import onnx
    from onnx import TensorProto, helper

    graph, params = Graph(), policy.params["params"]
    if isinstance(policy.network, QNetwork):
        result, size = _q_values(graph, policy, params), policy.network.num_actions
    else:
        result, size = _actor(graph, policy, params), policy.network.num_outputs
    graph.add("Identity", result, name=policy.output)
    action_type, action_shape = TensorProto.INT32, ["batch"]
    if isinstance(policy.action_space, Discrete):
        best = graph.add("ArgMax", result, axis=1, keepdims=0)
        graph.add("Cast", best, to=TensorProto.INT32, name=ACTION)
    else:
        action_type, action_shape = TensorProto.FLOAT, ["batch", policy.action_space.size]
        _squashed_mean(graph, policy.action_space, result)
    inputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *box.shape])
        for name, box in policy.inputs.items()
    ]
    outputs = [
        helper.make_tensor_value_info(policy.output, TensorProto.FLOAT, ["batch", size]),
        helper.make_tensor_value_info(ACTION, action_type, action_shape),
    ]
    if policy.memory is not None:
        outputs.append(
            helper.make_tensor_value_info(MEMORY_AFTER, TensorProto.FLOAT, ["batch", *policy.memory.shape])
        )
    model = helper.make_model(
        helper.make_graph(graph.nodes, "policy", inputs, outputs, graph.weights),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="pecjax",
        producer_version=pecjax.__version__,
    )
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _actor(graph: Graph, policy: Policy, params: dict[str, Any]) -> str:
    """The actor of `networks.ActorCritic`, without the critic."""
    settings = policy.network.settings
    if settings.encoder == "cnn":
        x = graph.dense(_convolved(graph, policy, params["actor_convolutions"]), params["actor_0"])
    elif policy.network.is_privileged or policy.memory is not None:
        x = graph.dense(_features(graph, policy), params["actor_0"])
    else:
        x = graph.dense(_features(graph, policy), params["first"], slice(settings.hidden[0]))
    x = graph.add("Tanh", x)
    if policy.memory is not None:
        is_stack = settings.memory == "stack"
        seen = _stacked(graph, policy, x) if is_stack else _remembered(graph, policy, x, params["memory"])
        x = graph.add("Concat", x, seen, axis=1)
    for layer in range(1, len(settings.hidden)):
        x = graph.add("Tanh", graph.dense(x, params[f"actor_{layer}"]))
    return graph.dense(x, params["actor_output"])


def _remembered(graph: Graph, policy: Policy, x: str, params: dict[str, Any]) -> str:
    """The memory after the step, of `memory.Cell`."""
    size, is_gru = policy.network.settings.memory_size, policy.network.settings.memory == "gru"
    *reset, gate, new = (graph.dense(x, params["read"], part) for part in _parts(size, 3 if is_gru else 2))
    if is_gru:
        layer = {"kernel": params["recall"], "bias": np.zeros(3 * size)}
        of_reset, of_gate, of_new = (graph.dense(MEMORY, layer, part) for part in _parts(size, 3))
        gate = graph.add("Add", gate, of_gate)
        of_new = graph.add("Add", of_new, graph.weight(params["recall_bias"]))
        share = graph.add("Sigmoid", graph.add("Add", *reset, of_reset))
        new = graph.add("Add", new, graph.add("Mul", share, of_new))
    share, new = graph.add("Sigmoid", gate), graph.add("Tanh", new)
    kept = graph.add("Mul", share, graph.add("Sub", MEMORY, new))  # (1 - z) n + z h = n + z (h - n)
    return graph.add("Add", new, kept, name=MEMORY_AFTER)


def _stacked(graph: Graph, policy: Policy, x: str) -> str:
    """What `memory.Stack` sees; its memory after the step has x in place of the oldest."""
    settings = policy.network.settings
    columns = np.arange(settings.memory_size * settings.hidden[0]).reshape(settings.memory_size, -1)
    newer = graph.add("Gather", MEMORY, graph.weight(columns[1:].ravel(), np.int64), axis=1)
    graph.add("Concat", newer, x, axis=1, name=MEMORY_AFTER)
    back = np.arange(settings.memory_stride, settings.memory_size + 1, settings.memory_stride)
    seen = columns[settings.memory_size - back]
    return graph.add("Gather", MEMORY, graph.weight(seen.ravel(), np.int64), axis=1)


def _parts(size: int, number: int) -> list[slice]:
    return [slice(k * size, (k + 1) * size) for k in range(number)]


def _q_values(graph: Graph, policy: Policy, params: dict[str, Any]) -> str:
    """The dueling network of `q_network.QNetwork`."""
    settings = policy.network.settings
    x = _features(graph, policy, as_kept=True)
    for layer in range(len(settings.trunk)):
        x = graph.add("Tanh", graph.dense(x, params[f"trunk_{layer}"]))
    parts = {"advantage": slice(settings.head), "value": slice(settings.head, None)}
    advantage, value = (
        graph.dense(graph.add("Relu", graph.dense(x, params["heads"], columns)), params[name])
        for name, columns in parts.items()
    )
    mean = graph.add("ReduceMean", advantage, axes=[1], keepdims=1)
    return graph.add("Sub", graph.add("Add", value, advantage), mean)


def _features(graph: Graph, policy: Policy, *, as_kept: bool = False) -> str:
    """The row of features of `observations.encode`; `as_kept`, of `unpack` after `pack`."""
    parts = []
    for box, place in in_order(policy.observation_space):
        x = graph.add("Flatten", policy.names[place])
        parts.append(_in_bytes(graph, box, x) if as_kept and is_byte(box) else x)
    return graph.add("Concat", *parts, axis=1)


def _in_bytes(graph: Graph, box: Box, x: str) -> str:
    """Rounded to the steps in which a replay keeps images."""
    low, extent, levels = (graph.weight(number) for number in (box.low, box.high - box.low, LEVELS))
    share = graph.add("Div", graph.add("Sub", x, low), extent)
    byte = graph.add("Round", graph.add("Mul", share, levels))
    return graph.add("Add", low, graph.add("Mul", graph.add("Div", byte, levels), extent))


def _convolved(graph: Graph, policy: Policy, params: dict[str, Any]) -> str:
    """Each image through its convolutions, and what is no image as it is."""
    parts, numbers = [], itertools.count()
    for box, place in in_order(policy.observation_space):
        name = policy.names[place]
        if not box.is_image:
            parts.append(graph.add("Flatten", name))
            continue
        height, width, channels = (*box.shape, 1)[:3]
        to_rows = graph.weight([-1, height, width, channels], np.int64)
        x = graph.add("Transpose", graph.add("Reshape", name, to_rows), perm=[0, 3, 1, 2])
        for filters, size in CONVOLUTIONS:
            layer = params[f"Dense_{next(numbers)}"]
            kernel = layer["kernel"].reshape(size, size, channels, filters).transpose(3, 2, 0, 1)
            beyond = [0, 0, -height % size, -width % size]
            x = graph.add(
                "Conv",
                x,
                graph.weight(kernel),
                graph.weight(layer["bias"]),
                kernel_shape=[size, size],
                strides=[size, size],
                pads=beyond,
            )
            x = graph.add("Relu", x)
            height, width, channels = -(-height // size), -(-width // size), filters
        parts.append(graph.add("Flatten", graph.add("Transpose", x, perm=[0, 2, 3, 1])))
    return graph.add("Concat", *parts, axis=1)


def _squashed_mean(graph: Graph, space: Box, parameters: str) -> None:
    """The mode of `distributions.tanh_normal`, as an action."""
    mean = graph.add("Gather", parameters, graph.weight(np.arange(space.size), np.int64), axis=1)
    low, high, half, one = (
        graph.weight(number) for number in (space.low, space.high, (space.high - space.low) / 2, 1.0)
    )
    share = graph.add("Mul", graph.add("Add", graph.add("Tanh", mean), one), half)
    graph.add("Clip", graph.add("Add", share, low), low, high, name=ACTION)
