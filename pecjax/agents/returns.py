"""Returns: advantages and targets.

Arrays of other shapes than are asked for might broadcast to a wrong result; they fail when traced.
"""

from __future__ import annotations

import chex
import jax
import jax.numpy as jnp


def generalized_advantage(
    rewards: jax.Array,
    values: jax.Array,
    dones: jax.Array,
    last_value: jax.Array,
    discount: float,
    gae_lambda: float,
) -> jax.Array:
    """Generalized advantage estimates (Schulman et al. 2016, Eq. 16).

        δ_t = r_t + γ (1 − d_t) V_{t+1} − V_t
        A_t = δ_t + γ λ (1 − d_t) A_{t+1}

    Nothing is taken from beyond an ending; `with_bootstrap` adds to the reward what an episode that was
    cut off would have gone on to see.

    Args:
        rewards, values, dones: (T, B); a done of 1 says that the episode ended in that step.
        last_value: (B,), the value of the state after the last step.

    Returns:
        (T, B); add `values` for the value targets. Oracle:
        `rlax.truncated_generalized_advantage_estimation`.
    """
    going_on = discount * (1 - dones)
    deltas = td_errors(rewards, values, dones, last_value, discount)

    def step(advantage: jax.Array, row: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        delta, carry_on = row
        advantage = delta + gae_lambda * carry_on * advantage
        return advantage, advantage

    return jax.lax.scan(step, jnp.zeros_like(last_value), (deltas, going_on), reverse=True)[1]


def td_errors(
    rewards: jax.Array, values: jax.Array, dones: jax.Array, last_value: jax.Array, discount: float
) -> jax.Array:
    """δ_t = r_t + γ (1 − d_t) V_{t+1} − V_t, (T, B), as in `generalized_advantage`."""
    chex.assert_equal_shape([rewards, values, dones])
    chex.assert_shape(last_value, rewards.shape[1:])
    next_values = jnp.concatenate([values[1:], last_value[None]])
    return rewards + discount * (1 - dones) * next_values - values


def maximised_negative_advantage(
    errors: jax.Array, dones: jax.Array, discount: float, gae_lambda: float
) -> jax.Array:
    """How much was lost after each step, had the best that came between been kept.

        −(1 − λ) Σ_i λ^i D_{t, t+i},   D_{t, k} = min(D_{t, k−1} + γ^{k−t} δ_k, 0),   D_{t, t−1} = 0

    where D stays as it is after an ending. Without the minimum it would be the generalized advantage,
    taken negative. Takes O(T²). MNA of Mead et al. 2026, "Improving regret approximation for unsupervised
    dynamic environment generation", as their code has it.

    Args:
        errors, dones: (T, B), the errors those of `td_errors`.

    Returns:
        (T, B), 0 or more.
    """
    chex.assert_equal_shape([errors, dones])
    starts = jnp.arange(len(errors))[:, None]

    def step(carry: tuple[jax.Array, ...], row: tuple[jax.Array, ...]) -> tuple[tuple[jax.Array, ...], None]:
        total, lost, is_over = carry
        now, error, done = row
        begun = starts <= now
        age = jnp.maximum(now - starts, 0)
        changed = jnp.minimum(lost + discount**age * error, 0.0)
        lost = jnp.where(begun & ~is_over, changed, lost)
        total = total + jnp.where(begun, (1 - gae_lambda) * gae_lambda**age * lost, 0.0)
        return (total, lost, is_over | (begun & (done > 0))), None

    nothing = jnp.zeros_like(errors)
    rows = (jnp.arange(len(errors)), errors, dones)
    (total, lost, _), _ = jax.lax.scan(step, (nothing, nothing, jnp.zeros(errors.shape, bool)), rows)
    return -(total + gae_lambda ** (len(errors) - starts) * lost)


def with_bootstrap(rewards: jax.Array, bootstrap: jax.Array | None, discount: float) -> jax.Array:
    """Rewards with the discounted value of what follows, where an episode was cut off.

        r_t + γ V(s_{t+1})

    After that the cut is an ending like any other: the estimates of this file are then those that bootstrap
    from the state that the episode was cut off in (Pardo et al. 2018, "Time limits in RL", Eq. 6).

    Args:
        bootstrap: of `rollout.Trajectory`; None leaves the rewards as they are.
    """
    if bootstrap is None:
        return rewards
    chex.assert_equal_shape([rewards, bootstrap])
    return rewards + discount * bootstrap


def n_step_return(
    rewards: jax.Array, dones: jax.Array, num_steps: int, discount: float
) -> tuple[jax.Array, jax.Array]:
    """The n-step return of every window of n steps, and the discount of the value that follows it.

        R_t = Σ_{k<n} γᵏ r_{t+k} Π_{i<k} (1 − d_{t+i})
        D_t = γⁿ Π_{i<n} (1 − d_{t+i})

    so that R_t + D_t V(s_{t+n}) is the target, and nothing is taken from beyond an ending.

    Args:
        rewards, dones: (T, …).

    Returns:
        (T − n + 1, …) each. Oracle: `rlax.n_step_bootstrapped_returns`.
    """
    chex.assert_equal_shape([rewards, dones])
    windows = rewards.shape[0] - num_steps + 1
    total, going_on = jnp.zeros_like(rewards[:windows]), jnp.ones_like(rewards[:windows])
    for k in range(num_steps):
        total = total + going_on * rewards[k : k + windows]
        going_on = going_on * discount * (1 - dones[k : k + windows])
    return total, going_on
