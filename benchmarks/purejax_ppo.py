"""PPO in the manner of PureJaxRL, on our environment: one jitted loop on one device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from pecjax.agents.observations import encode, num_values
from pecjax.envs.rooms import Rooms
from pecjax.envs.task import num_configs, take_configs

LAMBDA, CLIP, VALUE_COEFF = 0.95, 0.2, 0.5


class FlatRooms:
    """Our environment with flat observations, which resets itself to a configuration drawn uniformly."""

    def __init__(self, rooms: Rooms, reward_scale: float) -> None:
        self.task, self.world = rooms.make()
        self.reward_scale, self.size = reward_scale, num_values(self.task.observation_space)

    def flat(self, obs: Any) -> jax.Array:
        """An observation as our own networks are given it."""
        return encode(self.task.observation_space, obs)

    def _fresh(self, key: jax.Array) -> Any:
        key_row, key = jax.random.split(key)
        row = jax.random.randint(key_row, (), 0, num_configs(self.world.table))
        return self.task.reset(key, take_configs(self.world.table, row), self.world.params)

    def reset(self, key: jax.Array) -> tuple[jax.Array, Any]:
        """The first observation and state of an episode."""
        state = self._fresh(key)
        return self.flat(self.task.observe(key, state, self.world.params)), state

    def step(self, key: jax.Array, state: Any, action: jax.Array) -> tuple:
        """One action; where it ends the episode, what is seen is the next one's beginning."""
        after = self.task.step(key, state, action, self.world.params)
        done = after.terminated | after.truncated
        state = jax.tree.map(lambda new, old: jnp.where(done, new, old), self._fresh(key), after.state)
        obs = self.flat(self.task.observe(key, state, self.world.params))
        return obs, state, after.reward * self.reward_scale, done


class ActorCritic(nn.Module):
    """Two towers of tanh layers."""

    num_actions: int
    hidden: tuple[int, ...]

    @nn.compact
    def __call__(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        outputs = []
        for width, gain in ((self.num_actions, 0.01), (1, 1.0)):
            y = x
            for hidden in self.hidden:
                y = nn.tanh(nn.Dense(hidden, kernel_init=nn.initializers.orthogonal(2**0.5))(y))
            outputs.append(nn.Dense(width, kernel_init=nn.initializers.orthogonal(gain))(y))
        return outputs[0], outputs[1][..., 0]


def make_purejax(env: FlatRooms, settings: dict[str, Any]) -> tuple[Callable, Callable, Callable]:
    """(init, iterate, logits) of a training; the carry begins with the parameters."""
    num_envs, num_steps, discount = settings["num_envs"], settings["num_steps"], settings["discount"]
    number, epochs = settings["num_minibatches"], settings["num_epochs"]
    network = ActorCritic(env.task.action_space.num_actions, tuple(settings["hidden"]))
    optimizer = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(settings["learning_rate"], eps=1e-5))
    many_resets, many_steps = jax.vmap(env.reset), jax.vmap(env.step)

    def init(key: jax.Array) -> tuple:
        key, key_params, key_envs = jax.random.split(key, 3)
        obs, state = many_resets(jax.random.split(key_envs, num_envs))
        params = network.init(key_params, obs[:1])
        return params, optimizer.init(params), obs, state, key

    def loss(params: Any, batch: tuple) -> jax.Array:
        obs, action, old, advantage, target = batch
        logits, value = network.apply(params, obs)
        log_probs = jax.nn.log_softmax(logits)
        ratio = jnp.exp(jnp.take_along_axis(log_probs, action[:, None], -1)[:, 0] - old)
        scaled = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        gain = jnp.minimum(ratio * scaled, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * scaled).mean()
        entropy = -(jnp.exp(log_probs) * log_probs).sum(-1).mean()
        return VALUE_COEFF * jnp.square(value - target).mean() - gain - settings["entropy_coeff"] * entropy

    def iterate(carry: tuple) -> tuple:
        params, opt_state, obs, state, key = carry
        key, key_act, key_learn = jax.random.split(key, 3)

        def act(carry: tuple, key: jax.Array) -> tuple:
            obs, state = carry
            key_action, key_step = jax.random.split(key)
            logits, value = network.apply(params, obs)
            action = jax.random.categorical(key_action, logits)
            old = jnp.take_along_axis(jax.nn.log_softmax(logits), action[:, None], -1)[:, 0]
            after, state, reward, done = many_steps(jax.random.split(key_step, num_envs), state, action)
            return (after, state), (obs, action, old, value, reward, done)

        (obs, state), (*seen, value, reward, done) = jax.lax.scan(
            act, (obs, state), jax.random.split(key_act, num_steps)
        )
        following = jnp.concatenate([value[1:], network.apply(params, obs)[1][None]])
        on = discount * (1.0 - done)
        errors = reward + on * following - value
        _, advantage = jax.lax.scan(
            lambda a, x: (x[0] + LAMBDA * x[1] * a,) * 2, jnp.zeros(num_envs), (errors, on), reverse=True
        )
        batch = (*seen, advantage, advantage + value)
        flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), batch)

        def epoch(carry: tuple, key: jax.Array) -> tuple:
            order = jax.random.permutation(key, num_envs * num_steps).reshape(number, -1)

            def learn(carry: tuple, rows: jax.Array) -> tuple:
                params, opt_state = carry
                gradient = jax.grad(loss)(params, jax.tree.map(lambda leaf: leaf[rows], flat))
                updates, opt_state = optimizer.update(gradient, opt_state)
                return (optax.apply_updates(params, updates), opt_state), None

            return jax.lax.scan(learn, carry, order)

        (params, opt_state), _ = jax.lax.scan(epoch, (params, opt_state), jax.random.split(key_learn, epochs))
        return params, opt_state, obs, state, key

    return jax.jit(init), jax.jit(iterate, donate_argnums=0), lambda params, x: network.apply(params, x)[0]
