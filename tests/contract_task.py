"""What every task must keep to, whoever wrote it: import it and call `check_task`."""

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import num_configs, take_configs


def signature(tree):
    return jax.tree.map(lambda x: (jnp.shape(x), jnp.result_type(x)), tree)


def some_action(task, key):
    space = task.action_space
    if isinstance(space, Discrete):
        return jax.random.randint(key, (), 0, space.num_actions)
    return jax.random.uniform(key, space.shape, minval=space.low, maxval=space.high)


def check_task(task, world, steps=60, episodes=6):
    """Fails where the task does not keep to its contract.

    Args:
        steps: that a few environments are stepped for, their actions drawn at random.
    """
    key = jax.random.key(0)
    number = num_configs(world.table)
    assert all(leaf.shape[0] == number for leaf in jax.tree.leaves(world.table)), "one length for all leaves"
    assert isinstance(task.action_space, Box | Discrete) and task.max_steps >= 1
    assert all(isinstance(box, Box) for box in jax.tree.leaves(task.observation_space))
    assert set(task.metrics.values()) <= {"last", "sum", "mean", "min", "max"}
    ids = jnp.arange(episodes) % number
    reset = jax.vmap(lambda k, c, p: task.reset(k, c, p), (0, 0, None))
    step = jax.jit(jax.vmap(lambda k, s, a, p: task.step(k, s, a, p), (0, 0, 0, None)))
    observe = jax.jit(jax.vmap(lambda k, s, p: task.observe(k, s, p), (0, 0, None)))
    keys = jax.random.split(key, episodes)
    state = jax.jit(reset)(keys, take_configs(world.table, ids), world.params)
    first = signature(state)
    seen = observe(keys, state, world.params)
    of_boxes = [box.shape for box in jax.tree.leaves(task.observation_space)]
    assert [leaf.shape[1:] for leaf in jax.tree.leaves(seen)] == of_boxes, "as the space says"
    if task.privileged_space is not None:
        known = jax.jit(jax.vmap(task.privileged, (0, None)))(state, world.params)
        of_boxes = [box.shape for box in jax.tree.leaves(task.privileged_space)]
        assert [leaf.shape[1:] for leaf in jax.tree.leaves(known)] == of_boxes, "as the space says"
    # All that is drawn is drawn from the key, also where it is traced anew.
    again = jax.jit(lambda *args: reset(*args))(keys, take_configs(world.table, ids), world.params)
    jax.tree.map(np.testing.assert_array_equal, state, again)

    ended, truncated = 0, 0
    length = np.zeros(episodes, int)
    for n in range(steps):
        now = jax.random.split(jax.random.fold_in(key, n), episodes)
        action = jax.vmap(lambda k: some_action(task, k))(now)
        after = step(now, state, action, world.params)
        assert signature(after.state) == first, "a step keeps structure, shapes and types of the state"
        assert after.reward.dtype == jnp.float32 and after.reward.shape == (episodes,)
        for flag in (after.terminated, after.truncated, after.success):
            assert flag.dtype == bool and flag.shape == (episodes,)
        assert set(after.metrics) == set(task.metrics), "every metric that is named, and no other"
        seen = observe(now, after.state, world.params)
        for box, leaf in zip(jax.tree.leaves(task.observation_space), jax.tree.leaves(seen), strict=True):
            assert np.isfinite(leaf).all()
            assert (leaf >= box.low - 1e-5).all() and (leaf <= box.high + 1e-5).all(), "within its bounds"
        done = np.asarray(after.terminated | after.truncated)
        length += 1
        assert (length <= task.max_steps).all() or task.max_steps > steps
        ended, truncated = ended + done.sum(), truncated + int(after.truncated.sum())
        fresh = reset(now, take_configs(world.table, ids), world.params)
        state = jax.tree.map(
            lambda new, old, done=done: jnp.where(done.reshape(-1, *[1] * (old.ndim - 1)), new, old),
            fresh,
            after.state,
        )
        length[done] = 0
    assert truncated == 0 or task.truncates, "what is ever truncated says so"
    return ended
