"""Distributions over actions: the numbers of a network's output become actions that are drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.spaces import Box, Discrete
from pecjax.errors import InputError

MIN_SCALE = 1e-3  # of a normal distribution


class Distribution(NamedTuple):
    """Functions of parameters (…, P) that a network puts out.

    What is drawn is kept as it was drawn, so that its probability can be had later; `action` makes of
    it what the environment takes.

    Attributes:
        num_params: P.
        noise: (key) -> all the randomness of one draw.
        draw: (params, noise) -> what is drawn.
        mode: (params) -> the draw of highest density.
        action: (drawn) -> the environment's action.
        log_prob: (params, drawn) -> (…,), of the action.
        kl: (old params, new params) -> (…,), KL(old ‖ new).
        entropy: (params, old params, drawn) -> (…,), of the action; where it has no closed form, an
            unbiased estimate from the noise by which `drawn` was drawn from the old parameters.
    """

    num_params: int
    noise: Callable[[jax.Array], jax.Array]
    draw: Callable[[jax.Array, jax.Array], jax.Array]
    mode: Callable[[jax.Array], jax.Array]
    action: Callable[[jax.Array], jax.Array]
    log_prob: Callable[[jax.Array, jax.Array], jax.Array]
    kl: Callable[[jax.Array, jax.Array], jax.Array]
    entropy: Callable[[jax.Array, jax.Array, jax.Array], jax.Array]


def make_distribution(space: Any) -> Distribution:
    """Categorical for `Discrete` actions, a normal squashed into the bounds for those of a `Box`.

    Raises:
        InputError: a box without bounds, or another space.
    """
    if isinstance(space, Discrete):
        return categorical(space.num_actions)
    if isinstance(space, Box) and np.isfinite([space.low, space.high]).all() and len(space.shape) == 1:
        return tanh_normal(space)
    raise InputError(
        f"no policy for the action space {space}; give Discrete(n), or Box((n,), low, high) of finite bounds"
    )


def categorical(num_actions: int) -> Distribution:
    """Parameters are logits (…, A), an action an int32 in [0, A)."""

    def draw(logits: jax.Array, uniform: jax.Array) -> jax.Array:
        """Inverts the distribution function at `uniform` (…,), uniform in [0, 1)."""
        reached = jnp.cumsum(jax.nn.softmax(logits), axis=-1)[..., :-1]
        return jnp.sum(uniform[..., None] >= reached, axis=-1, dtype=jnp.int32)

    def log_prob(logits: jax.Array, action: jax.Array) -> jax.Array:
        chosen = action[..., None] == jnp.arange(num_actions)  # no gather: its gradient would be a scatter
        return jnp.sum(jnp.where(chosen, jax.nn.log_softmax(logits), 0.0), axis=-1)

    def kl(old: jax.Array, new: jax.Array) -> jax.Array:
        old, new = jax.nn.log_softmax(old), jax.nn.log_softmax(new)
        return jnp.sum(jnp.exp(old) * (old - new), axis=-1)

    def entropy(logits: jax.Array, old: jax.Array, drawn: jax.Array) -> jax.Array:
        log_probs = jax.nn.log_softmax(logits)
        return -jnp.sum(jnp.exp(log_probs) * log_probs, axis=-1)

    return Distribution(
        num_actions,
        jax.random.uniform,
        draw,
        lambda logits: jnp.argmax(logits, axis=-1).astype(jnp.int32),
        lambda action: action,
        log_prob,
        kl,
        entropy,
    )


def tanh_normal(space: Box) -> Distribution:
    """Independent normals (…, A), squashed by tanh into the bounds (Haarnoja et al. 2018, App. C).

    Parameters (…, 2 A) are means, and what softplus makes standard deviations of. What is drawn is the
    normal before it is squashed.
    """
    (size,) = space.shape
    half = (space.high - space.low) / 2

    def parts(params: jax.Array) -> tuple[jax.Array, jax.Array]:
        mean, raw = jnp.split(params, 2, axis=-1)
        return mean, jax.nn.softplus(raw) + MIN_SCALE

    def draw(params: jax.Array, noise: jax.Array) -> jax.Array:
        mean, scale = parts(params)
        return mean + scale * noise

    def action(drawn: jax.Array) -> jax.Array:
        # A rounded sum may pass the bound.
        return jnp.clip(space.low + half * (jnp.tanh(drawn) + 1), space.low, space.high)

    def stretch(drawn: jax.Array) -> jax.Array:
        """Log |∂ action / ∂ drawn|, log(1 - tanh² u) = 2 (log 2 - u - softplus(-2 u)) where tanh is 1."""
        squashed = 2 * (jnp.log(2.0) - drawn - jax.nn.softplus(-2 * drawn))
        return jnp.sum(squashed + jnp.log(half), axis=-1)

    def log_prob(params: jax.Array, drawn: jax.Array) -> jax.Array:
        return jnp.sum(jax.scipy.stats.norm.logpdf(drawn, *parts(params)), axis=-1) - stretch(drawn)

    def kl(old: jax.Array, new: jax.Array) -> jax.Array:
        (mean, scale), (new_mean, new_scale) = parts(old), parts(new)
        moved = (jnp.square(scale) + jnp.square(mean - new_mean)) / (2 * jnp.square(new_scale))
        return jnp.sum(jnp.log(new_scale / scale) + moved - 0.5, axis=-1)

    def entropy(params: jax.Array, old: jax.Array, drawn: jax.Array) -> jax.Array:
        mean, scale = parts(old)
        again = draw(params, (drawn - mean) / scale)  # by the same noise
        of_normal = jnp.sum(0.5 * jnp.log(2 * jnp.pi * jnp.e) + jnp.log(parts(params)[1]), axis=-1)
        return of_normal + stretch(again)

    return Distribution(
        2 * size,
        lambda key: jax.random.normal(key, (size,)),
        draw,
        lambda params: parts(params)[0],
        action,
        log_prob,
        kl,
        entropy,
    )
