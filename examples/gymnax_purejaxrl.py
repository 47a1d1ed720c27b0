"""PPO in one jitted program, in the manner of PureJaxRL, over CartPoles of many lengths and gravities.

    python examples/gymnax_purejaxrl.py    (after pip install -e ".[gymnax]")

The curriculum is the lines that end with `# PEC`; the others would be there without it.
"""

import flax.linen as nn
import gymnax
import jax
import jax.numpy as jnp
import numpy as np
import optax

from pecjax.curriculum import Outcomes, pec  # PEC
from pecjax.curriculum.wrappers.gymnax import Curriculum, CurriculumParams  # PEC
from pecjax.envs.gymnax import params_table  # PEC

NUM_ENVS, NUM_STEPS, NUM_EPOCHS, DISCOUNT, LAMBDA, CLIP = 64, 128, 8, 0.99, 0.95, 0.2
LENGTH, GRAVITY = (grid.ravel() for grid in np.meshgrid(np.geomspace(0.1, 2.5, 6), [5.0, 9.8, 20.0]))


def main(num_updates=200, seed=0):
    """Trains and prints how often poles fell; returns trials and failures, and what the sampler was told."""
    env, params = gymnax.make("CartPole-v1")
    table = params_table(params, length=LENGTH, polemass_length=0.1 * LENGTH, gravity=GRAVITY)  # PEC
    env, sampler = Curriculum(env), pec(len(LENGTH))  # PEC
    step, split = jax.vmap(env.step, (0, 0, 0, None)), jax.random.split
    network = nn.Sequential([nn.Dense(128), nn.tanh, nn.Dense(128), nn.tanh, nn.Dense(3)])  # 2 logits, value
    optimizer = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(1e-3))
    minus_log_prob = optax.softmax_cross_entropy_with_integer_labels

    def loss(weights, obs, action, old, advantage, target):
        out = network.apply(weights, obs)
        ratio = jnp.exp(old - minus_log_prob(out[..., :2], action))
        scaled = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        gain = jnp.minimum(ratio * scaled, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * scaled)
        return (1e-3 * (out[..., 2] - target) ** 2 - gain).mean()

    def update(carry, key):
        (weights, _), obs, state, curriculum = carry
        params = CurriculumParams(table, sampler.probabilities(curriculum))  # PEC

        def act(carry, key):
            keys = split(key, NUM_ENVS + 1)
            out = network.apply(weights, carry[0])
            action = jax.random.categorical(keys[0], out[:, :2])
            *after, reward, fell, timeout, info = step(keys[1:], carry[1], action, params)
            seen = (carry[0], action, minus_log_prob(out[:, :2], action), out[:, 2], reward)
            return tuple(after), (seen, info["config_id"], fell | timeout, fell)

        (obs, state), (seen, *told) = jax.lax.scan(act, (obs, state), split(key, NUM_STEPS))
        curriculum = sampler.update(curriculum, Outcomes(*told))  # PEC
        *seen, value, reward = seen
        following = jnp.append(value[1:], network.apply(weights, obs)[None, :, 2], axis=0)
        on = DISCOUNT * (1.0 - told[1])
        errors = (reward + on * following - value, LAMBDA * on)
        _, advantage = jax.lax.scan(lambda a, x: (x[0] + x[1] * a,) * 2, 0 * on[0], errors, reverse=True)

        def epoch(_, learner):
            slope = jax.grad(loss)(learner[0], *seen, advantage, advantage + value)
            change, moments = optimizer.update(slope, learner[1])
            return optax.apply_updates(learner[0], change), moments

        return (jax.lax.fori_loop(0, NUM_EPOCHS, epoch, carry[0]), obs, state, curriculum), told

    keys, curriculum = split(jax.random.key(seed), num_updates + 2), sampler.init()  # PEC
    params = CurriculumParams(table, sampler.probabilities(curriculum))  # PEC
    obs, state = jax.vmap(env.reset, (0, None))(split(keys[0], NUM_ENVS), params)
    carry = ((weights := network.init(keys[1], obs), optimizer.init(weights)), obs, state, curriculum)
    (*_, curriculum), told = jax.jit(lambda *args: jax.lax.scan(update, *args))(carry, keys[2:])
    trials, falls = np.asarray(curriculum.statistics)
    late = told[2][-20:].sum() / told[1][-20:].sum()
    print(f"fell: {late:.2f} of the last ones; of all", (falls / trials).reshape(3, -1).round(2), sep="\n")
    return trials, falls, told


if __name__ == "__main__":
    main()
