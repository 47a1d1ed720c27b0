"""Networks: from features to the parameters of an action's distribution and a value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True)
class NetworkSettings:
    """Settings of the actor and the critic, which share no layer.

    Attributes:
        encoder: `mlp` flattens the image; `cnn` passes it through three convolutions that shrink
            it 16 times each way, for images of about 32 pixels and more.
        hidden: widths of the tanh layers.
        initializer: of the weights: `orthogonal` (gain √2 hidden, 0.01 actor, 1 critic) or
            `normc` (unit-norm columns, 0.01 at both outputs, as in RLlib 0.8.5).
    """

    encoder: Literal["mlp", "cnn"] = "mlp"
    hidden: tuple[int, ...] = (64, 64)
    initializer: Literal["orthogonal", "normc"] = "orthogonal"


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
    """

    settings: NetworkSettings
    num_outputs: int
    image_shapes: tuple[tuple[int, ...], ...]

    @nn.compact
    def __call__(self, features: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See `forward`, which is this with the parameters given."""
        settings = self.settings
        critic_gain = 0.01 if settings.initializer == "normc" else 1.0
        outputs = {"actor": (self.num_outputs, 0.01), "critic": (1, critic_gain)}
        if settings.encoder == "cnn":
            first = [
                _dense(settings, settings.hidden[0], f"{name}_0")(
                    _Convolutions(self.image_shapes, name=f"{name}_convolutions")(features)
                )
                for name in outputs
            ]
        else:
            # Both first layers in one matrix product: they read the same features, most of the work.
            both = nn.Dense(
                2 * settings.hidden[0], kernel_init=_two_halves(_kernel_init(settings)), name="first"
            )
            first = jnp.split(both(features), 2, axis=-1)
        result = []
        for (name, (width, gain)), x in zip(outputs.items(), first, strict=True):
            for layer, hidden in enumerate(settings.hidden[1:], 1):
                x = _dense(settings, hidden, f"{name}_{layer}")(nn.tanh(x))
            result.append(_dense(settings, width, f"{name}_output", gain)(nn.tanh(x)))
        logits, value = result
        return logits, value[..., 0]


def _kernel_init(settings: NetworkSettings, gain: float = np.sqrt(2)) -> Initializer:
    if settings.initializer == "normc":
        return normc(min(gain, 1.0))
    return nn.initializers.orthogonal(gain)


def _two_halves(init: Initializer) -> Initializer:
    def halves(key: jax.Array, shape: tuple[int, ...], dtype: np.dtype = jnp.float32) -> jax.Array:
        parts = [init(k, (*shape[:-1], shape[-1] // 2), dtype) for k in jax.random.split(key)]
        return jnp.concatenate(parts, axis=-1)

    return halves


def _dense(settings: NetworkSettings, width: int, name: str, gain: float = np.sqrt(2)) -> nn.Dense:
    return nn.Dense(width, kernel_init=_kernel_init(settings, gain), name=name)


class _Convolutions(nn.Module):
    """Three convolutions over each image, and what is no image as it is.

    Their kernels do not overlap (4×4, 2×2, 2×2), so that each is a matrix product over patches,
    which XLA is quick at on every device; its convolutions' gradients are slow on the CPU.
    """

    image_shapes: tuple[tuple[int, ...], ...]

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        parts = []
        for shape in self.image_shapes:
            pixels = int(np.prod(shape))
            x, features = features[..., :pixels], features[..., pixels:]
            x = x.reshape(*x.shape[:-1], *shape[:2], *(shape[2:] or (1,)))
            for channels, kernel in CONVOLUTIONS:
                x = nn.relu(nn.Dense(channels)(patches(x, kernel)))
            parts.append(x.reshape(*x.shape[:-3], -1))
        return jnp.concatenate([*parts, features], axis=-1)


def patches(image: jax.Array, size: int) -> jax.Array:
    """Cuts (…, H, W, C) into squares, (…, ⌈H/size⌉, ⌈W/size⌉, size²·C), zeros beyond the edge."""
    *batch, height, width, channels = image.shape
    rows, columns = -(-height // size), -(-width // size)
    edge = [(0, 0)] * len(batch) + [(0, rows * size - height), (0, columns * size - width), (0, 0)]
    cut = jnp.pad(image, edge).reshape(*batch, rows, size, columns, size, channels)
    return jnp.moveaxis(cut, -4, -3).reshape(*batch, rows, columns, size * size * channels)


def forward(network: ActorCritic, params: Any, features: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Parameters of the distribution (…, P) and values (…,) under the given parameters."""
    return cast(tuple[jax.Array, jax.Array], network.apply(params, features))
