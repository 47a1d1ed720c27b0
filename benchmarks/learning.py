"""Learning: workloads of samplers, replay and learners."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec
from workloads import SAME, Workload, sharded, waiting

from pecjax.agents import AXIS, PPO, AgentSettings, Apex, shard
from pecjax.agents.apex import replay
from pecjax.agents.distributions import make_distribution
from pecjax.agents.networks import forward
from pecjax.agents.observations import encode
from pecjax.agents.ppo.agent import critic_features, make_network
from pecjax.agents.ppo.update import Flown, Learner, make_optimizer, prepare, update
from pecjax.agents.rollout import Seen, Trajectory
from pecjax.agents.sharding import env_keys
from pecjax.curriculum import Outcomes, Sampler
from pecjax.envs.task import Task, World
from pecjax.training.build import everywhere


def training(task: Task, world: World, sampler: Sampler, mesh: Mesh, settings: AgentSettings) -> Workload:
    """PPO or Ape-X end to end, Ape-X once its replay is warm."""
    if isinstance(settings, Apex):
        settings = dataclasses.replace(settings, learning_starts=0)
    agent, world = shard(settings.make(task, sampler, AXIS), mesh), everywhere(world, mesh)
    carry = [agent.init(jax.random.key(0), world)]
    iterate = jax.jit(agent.iterate, donate_argnums=0)

    def run() -> None:
        carry[0], metrics = iterate(carry[0], world)
        jax.block_until_ready(metrics)

    return Workload(run, agent.steps_per_iteration, "control steps/s")


def learner(task: Task, mesh: Mesh, settings: PPO) -> tuple[Workload, Workload]:
    """The policy's step (forward and draw) and the update, on made-up batches."""
    space, distribution = task.observation_space, make_distribution(task.action_space)
    network = make_network(task, settings)
    key = jax.random.key(0)
    shape = (settings.num_steps, settings.num_envs)
    obs = {
        "depth": jax.random.uniform(key, (*shape, *space["depth"].shape)),
        "goal": jax.random.normal(key, (*shape, *space["goal"].shape)),
    }
    features = encode(space, obs)
    told = jax.tree.map(lambda box: jax.random.normal(key, (*shape, *box.shape)), task.privileged_space)
    known = encode(task.privileged_space, told)
    seen = Seen(obs, known)
    known = critic_features(task, seen, settings.network.critic) if network.is_privileged else None
    params = network.init(key, features[0, :1], None if known is None else known[0, :1])
    optimizer = make_optimizer(settings)
    state = Learner(params, optimizer.init(params), jnp.float32(0))
    logits, value, *_ = jax.jit(lambda *f: forward(network, params, *f))(features, known)
    action = jax.random.randint(key, shape, 0, distribution.num_params)
    reward = jax.random.normal(key, shape)
    done = jnp.float32(reward > 2)
    recorded = features.astype(jnp.bfloat16 if settings.network.precision == "bfloat16" else jnp.float32)
    flown = Flown(recorded, known, action, logits, value)
    trajectory = Trajectory(None, action, reward, done, None, flown)

    def act(params, seen, key):
        noise = jax.random.uniform(key, seen.obs["goal"].shape[:2])

        def step(_, row):
            seen, noise = row
            known = critic_features(task, seen, settings.network.critic) if network.is_privileged else None
            logits, value, *_ = forward(network, params, encode(space, seen.obs), known)
            return None, (distribution.draw(logits, noise), value)

        return jax.lax.scan(step, None, (seen, noise))[1]

    def learn(state, trajectory, key):
        batch = prepare(settings, distribution, trajectory, trajectory.reward[0], AXIS)
        return update(network, distribution, optimizer, settings, state, batch, key, AXIS)

    over_envs = PartitionSpec(None, AXIS)
    policy = sharded(act, mesh, (SAME, over_envs, SAME), over_envs)
    learning = sharded(learn, mesh, (SAME, over_envs, SAME), SAME)
    amount = settings.num_steps * settings.num_envs
    # Where they are in a training: not to be copied there at every call.
    params, state, key = (jax.device_put(x, jax.NamedSharding(mesh, SAME)) for x in (params, state, key))
    seen, trajectory = (jax.device_put(x, jax.NamedSharding(mesh, over_envs)) for x in (seen, trajectory))
    return (
        Workload(waiting(policy, params, seen, key), amount, "control steps/s"),
        Workload(waiting(learning, state, trajectory, key), amount, "control steps/s"),
    )


def curriculum(sampler: Sampler, num_configs: int, draws: int) -> tuple[Workload, Workload]:
    """A draw and a tally of so many episodes, and a plain copy of the counts to hold it against."""

    def draw_and_tally(carry):
        state, key = carry
        key, key_now = jax.random.split(key)
        ids = sampler.sample(state, key_now, (draws,))
        what = jnp.ones(draws)  # length, return and signal
        outcomes = Outcomes(ids, jnp.ones(draws, bool), ids % 3 == 0, what, what, what)
        return sampler.update(state, outcomes), key

    program = jax.jit(draw_and_tally, donate_argnums=0)  # as a training does it
    carry = [jax.tree.map(jnp.copy, (sampler.init(), jax.random.key(0)))]

    def run() -> None:
        carry[0] = jax.block_until_ready(program(carry[0]))

    counts = jnp.zeros((2, num_configs), jnp.int32)
    copy = jax.jit(lambda counts: counts + 1)
    return Workload(run, 1, "times/s"), Workload(waiting(copy, counts), 1, "times/s")


def sampling(sampler: Sampler, num_configs: int, mesh: Mesh, settings: PPO) -> Workload:
    """A sampler's own part of an iteration: every environment's draws, and what it learns of endings.

    A hundred times in one program, since one takes less than starting a program does.
    """
    shape = (settings.num_steps, settings.num_envs)
    key, key_done, key_failed = jax.random.split(jax.random.key(0), 3)
    done = jax.random.bernoulli(key_done, 1 / 40, shape)  # episodes of some forty steps
    failed = jax.random.bernoulli(key_failed, 0.1, shape)

    def many(state, key, env_ids, done, failed):
        def draw_and_learn(state, key):
            keys = env_keys(key, env_ids)
            ids = jax.vmap(lambda k: sampler.sample(state, k, shape[:1]), out_axes=1)(keys)
            ids = jax.lax.optimization_barrier(ids)  # drawn once, as before a rollout, for all that use them
            return sampler.update(state, Outcomes(ids, done, failed), AXIS), ids.sum()

        return jax.lax.scan(draw_and_learn, state, jax.random.split(key, 100))

    over_envs = PartitionSpec(None, AXIS)
    specs = (SAME, SAME, PartitionSpec(AXIS), over_envs, over_envs)
    program = sharded(many, mesh, specs, (SAME, SAME))
    args = (sampler.init(), key, jnp.arange(shape[1]), done, failed)
    placed = (jax.device_put(x, jax.NamedSharding(mesh, spec)) for x, spec in zip(args, specs, strict=True))
    return Workload(waiting(program, *placed), 100 * shape[0] * shape[1], "control steps/s")


REPLAY_ENVS, REPLAY_STEPS, REPLAY_DRAWS, N_STEP = 128, 2, 512, 3


def replay_parts(capacity: int) -> dict[str, Workload]:
    """One shard of so many transitions with 16×12 images: adding, drawing and new priorities."""
    settings = replay.ReplaySettings(capacity=capacity)
    shape = (REPLAY_STEPS, REPLAY_ENVS)
    number = jnp.zeros(shape)
    obs = (jnp.zeros((*shape, 192), jnp.uint8), jnp.zeros((*shape, 3)))
    rows = replay.Rows(obs, number.astype(jnp.int32), number, number, number + 1)

    def draw(shard: replay.Replay, key: jax.Array) -> tuple[replay.Replay, jax.Array]:
        batch = replay.sample(settings, shard, key, REPLAY_DRAWS, REPLAY_ENVS, N_STEP)
        # A sum over every image, so that none is optimised away.
        seen = batch.obs[0].sum() + batch.next_obs[0].sum() + batch.weight.sum()
        return shard, jnp.where(seen < 0, 0, batch.leaf)

    def new_priorities(shard: replay.Replay, key: jax.Array) -> tuple[replay.Replay, jax.Array]:
        leaf = jax.random.randint(key, (REPLAY_DRAWS,), 0, capacity)
        error = jax.random.uniform(key, (REPLAY_DRAWS,))
        return replay.reprioritize(settings, shard, leaf, error), leaf

    def draw_and_update(shard: replay.Replay, key: jax.Array) -> tuple[replay.Replay, jax.Array]:
        shard, leaf = draw(shard, key)
        error = jax.random.uniform(key, (REPLAY_DRAWS,))
        return replay.reprioritize(settings, shard, leaf, error), leaf

    def add(shard: replay.Replay, key: jax.Array) -> tuple[replay.Replay, jax.Array]:
        return replay.add(settings, shard, rows, N_STEP), jnp.zeros(())

    def workload(step: Callable) -> Workload:
        """A hundred times in one program, since one takes less than starting a program does."""
        program = jax.jit(
            lambda shard, key: jax.lax.scan(step, shard, jax.random.split(key, 100)), donate_argnums=0
        )
        shard = replay.empty(capacity // REPLAY_ENVS, REPLAY_ENVS, obs)
        error = jax.random.uniform(jax.random.key(0), (capacity,))
        carry = [replay.reprioritize(settings, shard, jnp.arange(capacity), error), jax.random.key(0)]

        def run() -> None:
            carry[1], key = jax.random.split(carry[1])
            carry[0], leaves = program(carry[0], key)
            jax.block_until_ready(leaves)

        return Workload(run, 100, "times/s")

    parts = {
        f"add {REPLAY_STEPS * REPLAY_ENVS}": add,
        f"draw {REPLAY_DRAWS}": draw,
        f"new priorities for {REPLAY_DRAWS}": new_priorities,
        f"draw {REPLAY_DRAWS} and update": draw_and_update,
    }
    return {name: workload(step) for name, step in parts.items()}
