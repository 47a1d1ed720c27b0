"""Memory: what networks carry from step to step of an episode."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import flax.linen as nn
import jax
import jax.numpy as jnp

from pecjax.agents.initializers import side_by_side

Kind = Literal["gru", "mingru", "stack"]
Product = Callable[..., jax.Array] | None


class Cell(nn.Module):
    """Numbers h (B, H) that each step changes, and that an episode begins with as zeros.

    `gru` is of Cho et al. (2014), with the reset gate behind the product as cuDNN and flax have it:

        r = σ(W_r x + U_r h), z = σ(W_z x + U_z h), n = tanh(W_n x + r ⊙ (U_n h + b)),
        h ← (1 - z) ⊙ n + z ⊙ h.

    `mingru` (Feng et al. 2024, "Were RNNs All We Needed?") leaves U out, so that all products are taken for
    all steps at once: h ← (1 - z) ⊙ tanh(W_n x) + z ⊙ h, with a tanh that theirs has not.

    Attributes:
        kind: `gru` or `mingru`.
        size: H.
        product: of what it reads, in place of `jax.lax.dot_general`; those of the memory are float32.
    """

    kind: Literal["gru", "mingru"]
    size: int
    product: Product = None

    @nn.compact
    def __call__(
        self, x: jax.Array, memory: jax.Array, starts: jax.Array | None = None
    ) -> tuple[jax.Array, jax.Array]:
        """Goes through L steps.

        Args:
            x: (L, B, F).
            memory: (B, H), before the first step.
            starts: (L, B), 1 where a step is an episode's first; None for nowhere.

        Returns:
            The memory after each step, (L, B, H), and after the last.
        """
        gates = 3 if self.kind == "gru" else 2
        read = nn.Dense(gates * self.size, name="read", dot_general=self.product)(x)
        kept = jnp.ones(x.shape[:2]) if starts is None else 1.0 - starts
        is_gru = self.kind == "gru"
        square, zeros = side_by_side(nn.initializers.orthogonal(), gates), nn.initializers.zeros
        recall = self.param("recall", square, (self.size, gates * self.size)) if is_gru else None
        bias = self.param("recall_bias", zeros, (self.size,)) if is_gru else None

        def step(h: jax.Array, of_step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            read, kept = of_step
            h = h * kept[:, None]
            if recall is None or bias is None:
                gate, new = jnp.split(read, 2, axis=-1)
            else:
                reset, gate, new = jnp.split(read, 3, axis=-1)
                of_reset, of_gate, of_new = jnp.split(h @ recall, 3, axis=-1)
                gate, new = gate + of_gate, new + nn.sigmoid(reset + of_reset) * (of_new + bias)
            share = nn.sigmoid(gate)
            h = (1.0 - share) * jnp.tanh(new) + share * h
            return h, h

        memory, seen = jax.lax.scan(step, memory, (read, kept))
        return seen, memory


class Stack(nn.Module):
    """What the last W steps gave, x (B, F) each, of which every S-th is seen: those before zeros.

    The memory is all of them side by side, (B, W F), the oldest first. It has no parameters.

    Attributes:
        stride: S.
    """

    stride: int

    def __call__(
        self, x: jax.Array, memory: jax.Array, starts: jax.Array | None = None
    ) -> tuple[jax.Array, jax.Array]:
        """Goes through L steps, as `Cell` does; what is seen is (L, B, (W // S) F)."""
        steps, envs, width = x.shape
        before = jnp.moveaxis(memory.reshape(envs, -1, width), 1, 0)
        window = before.shape[0]
        begun = jnp.zeros(x.shape[:2]) if starts is None else jnp.cumsum(starts, axis=0)
        # Which episode each step is of, counted from the one that was under way.
        episode = jnp.concatenate([jnp.zeros((window, envs)), begun])
        all_of = jnp.concatenate([before, x])

        def back(by: int) -> jax.Array:
            there = slice(window - by, window - by + steps)
            return all_of[there] * (episode[there] == begun)[..., None]

        seen = [back(by) for by in range(self.stride, window + 1, self.stride)]
        last = all_of[steps:] * (episode[steps:] == begun[-1])[..., None]
        return jnp.concatenate(seen, axis=-1), jnp.moveaxis(last, 0, 1).reshape(envs, -1)
