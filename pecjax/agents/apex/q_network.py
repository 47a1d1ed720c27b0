"""Q-network: from an observation to the values of the actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import flax.linen as nn
import jax
import jax.numpy as jnp


@dataclass(frozen=True)
class QNetworkSettings:
    """Settings of the dueling network (Wang et al. 2016).

    Attributes:
        trunk: widths of the tanh layers that both parts share.
        head: width of the relu layer of either part.
    """

    trunk: tuple[int, ...] = (128,)
    head: int = 128


class QNetwork(nn.Module):
    """Action values (…, A) of a batch of features (see `observations.encode`).

    Q = V + A − mean A    (Wang et al. 2016, Eq. 9)
    """

    settings: QNetworkSettings
    num_actions: int

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """See `action_values`, which is this with the parameters given."""
        x = features
        for layer, width in enumerate(self.settings.trunk):
            x = nn.tanh(nn.Dense(width, name=f"trunk_{layer}")(x))
        # Both first layers in one matrix product.
        advantage, value = jnp.split(nn.relu(nn.Dense(2 * self.settings.head, name="heads")(x)), 2, axis=-1)
        advantage = nn.Dense(self.num_actions, name="advantage")(advantage)
        value = nn.Dense(1, name="value")(value)
        return value + advantage - advantage.mean(axis=-1, keepdims=True)


def action_values(network: QNetwork, params: Any, features: jax.Array) -> jax.Array:
    """Action values (…, A) under the given parameters."""
    return cast(jax.Array, network.apply(params, features))
