"""Networks: from features to the parameters of an action's distribution and a value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from pecjax.agents.convolutions import Convolutions
from pecjax.agents.initializers import Initializer, normc, side_by_side
from pecjax.agents.memory import Cell, Kind, Stack
from pecjax.agents.products import bfloat16_product


@dataclass(frozen=True)
class NetworkSettings:
    """Settings of the actor and the critic, which share no layer.

    Attributes:
        encoder: `mlp` flattens the image; `cnn` passes it through three convolutions that shrink
            it 16 times each way, for images of about 32 pixels and more.
        hidden: widths of the tanh layers.
        initializer: of the weights: `orthogonal` (gain √2 hidden, 0.01 actor, 1 critic) or
            `normc` (unit-norm columns, 0.01 at both outputs, as in RLlib 0.8.5).
        critic: what the critic reads: `observation` is what the actor reads; `privileged` is what the task
            tells a critic of its state, with what of the observation is no image; `privileged_row` is that
            with the middle row of images, which is a camera's horizon. Both are the same as `observation`
            where the task tells nothing, as the rooms do where there are several maps.
        precision: of the operands of matrix products in training, but those of a GRU's memory; sums are
            float32 in any case. What is evaluated, watched and exported computes in float32.
        memory: what the network carries from step to step of an episode: `gru` and `mingru` are of
            `memory.Cell`, `stack` is `memory.Stack` of what the actor's first layer gave; None for nothing.
            The layers behind the first read it beside that.
        memory_size: how many numbers a cell carries, or how many steps a stack goes back.
        memory_stride: of so many steps of a stack one is read.
    """

    encoder: Literal["mlp", "cnn"] = "mlp"
    hidden: tuple[int, ...] = (64, 64)
    initializer: Literal["orthogonal", "normc"] = "orthogonal"
    critic: Literal["privileged_row", "privileged", "observation"] = "privileged_row"
    precision: Literal["bfloat16", "float32"] = "bfloat16"
    memory: Kind | None = None
    memory_size: int = 64
    memory_stride: int = 4

    @property
    def memory_numbers(self) -> int:
        """H, how many numbers are carried."""
        if self.memory is None:
            return 0
        return self.memory_size * (self.hidden[0] if self.memory == "stack" else 1)

    def first_memory(self) -> jax.Array | None:
        """(H,), what an episode begins with; None without a memory."""
        return None if self.memory is None else jnp.zeros(self.memory_numbers)


class Output(NamedTuple):
    """What a network puts out.

    Attributes:
        params: (…, P), of the action's distribution.
        value: (…,), None where the critic was not asked.
        memory: (B, H) after the last step, None of a network without one.
        auxiliary: (…, A), what the actor predicts beside; None of one that predicts nothing.
    """

    params: jax.Array
    value: Any
    memory: Any
    auxiliary: Any = None


class ActorCritic(nn.Module):
    """Parameters of the action's distribution (…, P) and state value (…,) of features (…, F).

    Attributes:
        num_outputs: P.
        image_shapes: (H, W) or (H, W, C) of the images that the features begin with.
        is_privileged: whether the critic has features of its own.
        num_auxiliary: A, how many numbers the actor's last layer predicts beside.
    """

    settings: NetworkSettings
    num_outputs: int
    image_shapes: tuple[tuple[int, ...], ...]
    is_privileged: bool = False
    num_auxiliary: int = 0

    @nn.compact
    def __call__(
        self,
        features: jax.Array,
        known: jax.Array | None = None,
        columns: jax.Array | None = None,
        memory: jax.Array | None = None,
        starts: jax.Array | None = None,
        with_value: bool = True,
    ) -> Output:
        """See `forward`, which is this with the parameters given.

        Args:
            with_value: whether the critic is asked, too, and what the actor predicts.
        """
        settings = self.settings
        if settings.encoder == "mlp" and settings.memory is None and not self.is_privileged:
            # Both first layers in one matrix product: they read the same features, most of the work.
            both = _dense(
                settings, 2 * settings.hidden[0], "first", side_by_side(_kernel_init(settings), 2), columns
            )
            actor, critic = jnp.split(nn.tanh(both(features)), 2, axis=-1)
        else:
            actor, critic = nn.tanh(self._first("actor", features, columns)), None
            if with_value:
                read, transposed = (features, columns) if known is None else (known, None)
                critic = nn.tanh(self._first("critic", read, transposed))
        if memory is not None and settings.memory is not None:
            cell = (
                Stack(settings.memory_stride, name="memory")
                if settings.memory == "stack"
                else Cell(settings.memory, settings.memory_size, _product(settings), name="memory")
            )
            in_time = (-1, memory.shape[0])
            begins = None if starts is None else starts.reshape(in_time)
            seen, memory = cell(actor.reshape(*in_time, actor.shape[-1]), memory, begins)
            seen = seen.reshape(actor.shape[0], -1)
            actor = jnp.concatenate([actor, seen], axis=-1)
            if critic is not None and known is None:
                critic = jnp.concatenate([critic, seen], axis=-1)
        actor = self._others("actor", actor)
        params = self._output("actor_output", actor, self.num_outputs, 0.01)
        if critic is None or not with_value:
            return Output(params, None, memory)
        gain = 0.01 if settings.initializer == "normc" else 1.0
        value = self._output("critic_output", self._others("critic", critic), 1, gain)[..., 0]
        if not self.num_auxiliary:
            return Output(params, value, memory)
        return Output(params, value, memory, self._output("auxiliary", actor, self.num_auxiliary, 1.0))

    def _first(self, name: str, x: jax.Array, columns: jax.Array | None = None) -> jax.Array:
        if self.settings.encoder == "cnn" and not (name == "critic" and self.is_privileged):
            columns = None
            x = Convolutions(self.image_shapes, _product(self.settings), name=f"{name}_convolutions")(x)
        return _dense(self.settings, self.settings.hidden[0], f"{name}_0", columns=columns)(x)

    def _others(self, name: str, x: jax.Array) -> jax.Array:
        for layer, hidden in enumerate(self.settings.hidden[1:], 1):
            x = nn.tanh(_dense(self.settings, hidden, f"{name}_{layer}")(x))
        return x

    def _output(self, name: str, x: jax.Array, width: int, gain: float) -> jax.Array:
        return _dense(self.settings, width, name, _kernel_init(self.settings, gain))(x)


def _kernel_init(settings: NetworkSettings, gain: float = np.sqrt(2)) -> Initializer:
    if settings.initializer == "normc":
        return normc(min(gain, 1.0))
    return nn.initializers.orthogonal(gain)


def _dense(
    settings: NetworkSettings,
    width: int,
    name: str,
    init: Initializer | None = None,
    columns: jax.Array | None = None,
) -> nn.Dense:
    init = init or _kernel_init(settings)
    return nn.Dense(width, kernel_init=init, name=name, dot_general=_product(settings, columns))


def _product(settings: NetworkSettings, columns: jax.Array | None = None) -> Callable[..., jax.Array] | None:
    return bfloat16_product(columns) if settings.precision == "bfloat16" else None


def forward(
    network: ActorCritic,
    params: Any,
    features: jax.Array,
    known: jax.Array | None = None,
    columns: jax.Array | None = None,
    memory: jax.Array | None = None,
    starts: jax.Array | None = None,
) -> Output:
    """What the network puts out under the given parameters.

    Args:
        features: (…, F). With a memory (N, F), the rows of B environments' first step, of their second, and
            so on.
        known: (…, K), the critic's features, where it has its own.
        columns: the features (N, F) transposed in memory, (F, N), see `bfloat16_product`.
        memory: (B, H), before the first step; None of a network without one.
        starts: (N,), 1 where a step is an episode's first; None for nowhere.
    """
    return cast(Output, network.apply(params, features, known, columns, memory, starts))


def decide(network: ActorCritic, params: Any, features: jax.Array, memory: jax.Array | None = None) -> Output:
    """One step without the critic, for flights beside training: in float32 in any case.

    Args:
        features: (…, F).
        memory: (…, H), None of a network without one.
    """
    exact = network.clone(settings=replace(network.settings, precision="float32"))
    if memory is None:
        return cast(Output, exact.apply(params, features, with_value=False))
    rows, carried = features.reshape(-1, features.shape[-1]), memory.reshape(-1, memory.shape[-1])
    out = cast(Output, exact.apply(params, rows, memory=carried, with_value=False))
    batch = features.shape[:-1]
    return Output(out.params.reshape(*batch, -1), None, out.memory.reshape(memory.shape))
