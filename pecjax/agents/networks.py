"""Networks: an observation becomes action logits and a value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

DISTANCE_SCALE = 10.0  # m; brings the distance to the goal near 1


@dataclass(frozen=True)
class NetworkSettings:
    """Settings of the actor and the critic, which share no layer.

    Attributes:
        encoder: `mlp` flattens the image; `cnn` passes it through three strided convolutions,
            for images of about 32 pixels and more.
        hidden: widths of the tanh layers.
        initializer: of the weights: `orthogonal` (gain √2 hidden, 0.01 actor, 1 critic) or
            `normc` (unit-norm columns, 0.01 at both outputs, as in RLlib 0.8.5).
    """

    encoder: Literal["mlp", "cnn"] = "mlp"
    hidden: tuple[int, ...] = (64, 64)
    initializer: Literal["orthogonal", "normc"] = "orthogonal"


def normc(scale: float) -> Callable[..., jax.Array]:
    """Normal columns scaled to length `scale` (RLlib 0.8.5, `models/tf/misc.py`)."""

    def init(key: jax.Array, shape: tuple[int, ...], dtype: np.dtype = jnp.float32) -> jax.Array:
        weights = jax.random.normal(key, shape, dtype)
        return scale * weights / jnp.linalg.norm(weights, axis=0, keepdims=True)

    return init


def encode(obs: dict[str, jax.Array], far: float) -> tuple[jax.Array, jax.Array]:
    """Brings an observation near the unit range.

    Args:
        obs: `depth` (…, H, W) m and `goal` (…, 2) m and rad.
        far: m, the depth that becomes 1.

    Returns:
        image (…, H, W), and (…, 3): distance, and sine and cosine of the bearing, which have no
        jump behind the drone.
    """
    distance, bearing = obs["goal"][..., 0], obs["goal"][..., 1]
    goal = jnp.stack([distance / DISTANCE_SCALE, jnp.sin(bearing), jnp.cos(bearing)], axis=-1)
    return obs["depth"] / far, goal


class _Tower(nn.Module):
    """One encoder, hidden layers and an output layer."""

    settings: NetworkSettings
    outputs: int
    output_gain: float

    def _dense(self, width: int, gain: float) -> nn.Dense:
        if self.settings.initializer == "normc":
            return nn.Dense(width, kernel_init=normc(min(gain, 1.0)))
        return nn.Dense(width, kernel_init=nn.initializers.orthogonal(gain))

    @nn.compact
    def __call__(self, image: jax.Array, goal: jax.Array) -> jax.Array:
        x = image
        if self.settings.encoder == "cnn":
            x = x[..., None]
            for channels, kernel in ((16, 5), (32, 3), (32, 3)):
                x = nn.relu(nn.Conv(channels, (kernel, kernel), strides=2)(x))
            x = x.reshape(*x.shape[:-3], -1)
        else:
            x = x.reshape(*x.shape[:-2], -1)
        x = jnp.concatenate([x, goal], axis=-1)
        for width in self.settings.hidden:
            x = nn.tanh(self._dense(width, np.sqrt(2))(x))
        return self._dense(self.outputs, self.output_gain)(x)


class ActorCritic(nn.Module):
    """Action logits (…, A) and state value (…,) of a batch of observations."""

    settings: NetworkSettings
    num_actions: int
    far: float

    @nn.compact
    def __call__(self, obs: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
        """See `forward`, which is this with the parameters given."""
        image, goal = encode(obs, self.far)
        critic_gain = 0.01 if self.settings.initializer == "normc" else 1.0
        logits = _Tower(self.settings, self.num_actions, 0.01, name="actor")(image, goal)
        value = _Tower(self.settings, 1, critic_gain, name="critic")(image, goal)
        return logits, value[..., 0]


def forward(network: ActorCritic, params: Any, obs: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Action logits (…, A) and values (…,) under the given parameters."""
    return cast(tuple[jax.Array, jax.Array], network.apply(params, obs))
