"""Networks: from features to the parameters of an action's distribution and a value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

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
            tells a critic of its state, with what of the observation is no image. It is the same as
            `observation` where the task tells nothing.
        precision: of the operands of matrix products in training, whose sums are float32 in any case. What
            is evaluated, watched and exported computes in float32.
    """

    encoder: Literal["mlp", "cnn"] = "mlp"
    hidden: tuple[int, ...] = (64, 64)
    initializer: Literal["orthogonal", "normc"] = "orthogonal"
    critic: Literal["privileged", "observation"] = "privileged"
    precision: Literal["bfloat16", "float32"] = "bfloat16"


Initializer = Callable[..., jax.Array]
CONVOLUTIONS = ((16, 4), (32, 2), (32, 2))  # channels, and the kernel's size, which is its stride too


def normc(scale: float) -> Initializer:
    """Normal columns scaled to length `scale` (RLlib 0.8.5, `models/tf/misc.py`)."""

    def init(key: jax.Array, shape: tuple[int, ...], dtype: np.dtype = jnp.float32) -> jax.Array:
        weights = jax.random.normal(key, shape, dtype)
        return scale * weights / jnp.linalg.norm(weights, axis=0, keepdims=True)

    return init


class ActorCritic(nn.Module):
    """Parameters of the action's distribution (…, P) and state value (…,) of features (…, F).

    Attributes:
        num_outputs: P.
        image_shapes: (H, W) or (H, W, C) of the images that the features begin with.
        is_privileged: whether the critic has features of its own.
    """

    settings: NetworkSettings
    num_outputs: int
    image_shapes: tuple[tuple[int, ...], ...]
    is_privileged: bool = False

    @nn.compact
    def __call__(
        self,
        features: jax.Array,
        known: jax.Array | None = None,
        columns: jax.Array | None = None,
        with_value: bool = True,
    ) -> tuple[jax.Array, jax.Array | None]:
        """See `forward`, which is this with the parameters given.

        Args:
            with_value: whether the critic is asked, too.
        """
        settings = self.settings
        if settings.encoder == "mlp" and not self.is_privileged:
            # Both first layers in one matrix product: they read the same features, most of the work.
            both = _dense(
                settings, 2 * settings.hidden[0], "first", _two_halves(_kernel_init(settings)), columns
            )
            actor, critic = jnp.split(both(features), 2, axis=-1)
        else:
            actor, critic = self._first("actor", features, columns), None
            if with_value:
                read, transposed = (features, columns) if known is None else (known, None)
                critic = self._first("critic", read, transposed)
        params = self._others("actor", actor, self.num_outputs, 0.01)
        if critic is None or not with_value:
            return params, None
        gain = 0.01 if settings.initializer == "normc" else 1.0
        return params, self._others("critic", critic, 1, gain)[..., 0]

    def _first(self, name: str, x: jax.Array, columns: jax.Array | None = None) -> jax.Array:
        if self.settings.encoder == "cnn" and not (name == "critic" and self.is_privileged):
            columns = None
            x = _Convolutions(self.settings, self.image_shapes, name=f"{name}_convolutions")(x)
        return _dense(self.settings, self.settings.hidden[0], f"{name}_0", columns=columns)(x)

    def _others(self, name: str, x: jax.Array, width: int, gain: float) -> jax.Array:
        for layer, hidden in enumerate(self.settings.hidden[1:], 1):
            x = _dense(self.settings, hidden, f"{name}_{layer}")(nn.tanh(x))
        return _dense(self.settings, width, f"{name}_output", _kernel_init(self.settings, gain))(nn.tanh(x))


def _kernel_init(settings: NetworkSettings, gain: float = np.sqrt(2)) -> Initializer:
    if settings.initializer == "normc":
        return normc(min(gain, 1.0))
    return nn.initializers.orthogonal(gain)


def _two_halves(init: Initializer) -> Initializer:
    def halves(key: jax.Array, shape: tuple[int, ...], dtype: np.dtype = jnp.float32) -> jax.Array:
        parts = [init(k, (*shape[:-1], shape[-1] // 2), dtype) for k in jax.random.split(key)]
        return jnp.concatenate(parts, axis=-1)

    return halves


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


class _Convolutions(nn.Module):
    """Three convolutions over each image, and what is no image as it is.

    Their kernels do not overlap (4×4, 2×2, 2×2), so that each is a matrix product over patches,
    which XLA is quick at on every device; its convolutions' gradients are slow on the CPU.
    """

    settings: NetworkSettings
    image_shapes: tuple[tuple[int, ...], ...]

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        parts, product = [], _product(self.settings)
        for shape in self.image_shapes:
            pixels = int(np.prod(shape))
            x, features = features[..., :pixels], features[..., pixels:]
            x = x.reshape(*x.shape[:-1], *shape[:2], *(shape[2:] or (1,)))
            for channels, kernel in CONVOLUTIONS:
                x = nn.relu(nn.Dense(channels, dot_general=product)(patches(x, kernel)))
            parts.append(x.reshape(*x.shape[:-3], -1))
        return jnp.concatenate([*parts, features], axis=-1)


def patches(image: jax.Array, size: int) -> jax.Array:
    """Cuts (…, H, W, C) into squares, (…, ⌈H/size⌉, ⌈W/size⌉, size²·C), zeros beyond the edge."""
    *batch, height, width, channels = image.shape
    rows, columns = -(-height // size), -(-width // size)
    edge = [(0, 0)] * len(batch) + [(0, rows * size - height), (0, columns * size - width), (0, 0)]
    cut = jnp.pad(image, edge).reshape(*batch, rows, size, columns, size, channels)
    return jnp.moveaxis(cut, -4, -3).reshape(*batch, rows, columns, size * size * channels)


def forward(
    network: ActorCritic,
    params: Any,
    features: jax.Array,
    known: jax.Array | None = None,
    columns: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Parameters of the distribution (…, P) and values (…,) under the given parameters.

    Args:
        known: (…, K), the critic's features, where it has its own.
        columns: the features (N, F) transposed in memory, (F, N), see `bfloat16_product`.
    """
    return cast(tuple[jax.Array, jax.Array], network.apply(params, features, known, columns))


def decide(network: ActorCritic, params: Any, features: jax.Array) -> jax.Array:
    """Parameters of the distribution (…, P) alone, for flights beside training: in float32 in any case."""
    exact = network.clone(settings=replace(network.settings, precision="float32"))
    return cast(tuple[jax.Array, None], exact.apply(params, features, with_value=False))[0]
