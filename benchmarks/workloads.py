"""Workloads: prepared pieces of work whose calls can be timed in turn."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from mujoco import mjx, rollout as c_rollout

import pecjax
from pecjax.agents import AXIS, apex, apex_update, fleet_mesh, ppo, ppo_update, replay, shard
from pecjax.agents.networks import ActorCritic, draw_action, encode, forward
from pecjax.agents.rollout import Trajectory, env_keys, launch, rollout
from pecjax.curriculum import Outcomes, Sampler
from pecjax.world.depth import depth_image, pixel_directions
from pecjax.world.flight import Command, fly, hover

SPREAD, SAME = PartitionSpec(AXIS), PartitionSpec()


class Workload(NamedTuple):
    """Something to time.

    Attributes:
        run: does the work once, to its end.
        amount: how much that is.
        unit: of what.
    """

    run: Callable[[], object]
    amount: float
    unit: str


def num_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def _sharded(function: Callable, mesh: Mesh, in_specs: tuple, out_specs: object) -> Callable:
    return jax.jit(
        jax.shard_map(function, mesh=mesh, in_specs=in_specs, out_specs=out_specs, check_vma=False)
    )


def _waiting(function: Callable, *args: object) -> Callable[[], object]:
    return lambda: jax.block_until_ready(function(*args))


def c_physics(env: pecjax.RoomsNavigation, num_envs: int, num_steps: int) -> Workload:
    """C MuJoCo's `rollout` on every core: the same model and physics steps, and nothing else."""
    model = env.scene.model
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    initial = np.tile(state, (num_envs, 1))
    hovering = env.scene.mass * 9.81 / model.nu
    shape = (num_envs, num_steps * env.physics_steps, model.nu)
    controls = np.random.default_rng(0).uniform(0.9 * hovering, 1.1 * hovering, shape)
    pool = c_rollout.Rollout(nthread=num_cores())
    threads = [mujoco.MjData(model) for _ in range(num_cores())]
    run = partial(pool.rollout, model, threads, initial, controls)
    return Workload(run, num_envs * num_steps, "control steps/s")


def flight(env: pecjax.RoomsNavigation, mesh: Mesh, num_envs: int, num_steps: int) -> Workload:
    """Our controller, MJX and the distance to the walls."""
    start = jnp.tile(jnp.array([0.0, -2.0, 1.2]), (num_envs, 1))
    drones = jax.vmap(hover)(start, jnp.linspace(-3, 3, num_envs))
    keys = jax.random.split(jax.random.key(0), 2)
    speeds = jax.random.uniform(keys[0], (num_steps, num_envs), maxval=2.0)
    turns = jax.random.uniform(keys[1], (num_steps, num_envs), minval=-1.5, maxval=1.5)

    def one(drone, speed, turn):
        return fly(env.scene, env.settings.gains, drone, Command(speed, turn, 1.2), env.physics_steps)

    def many(drones, speeds, turns):
        return jax.lax.scan(lambda d, row: jax.vmap(one)(d, *row), drones, (speeds, turns))

    over_envs = PartitionSpec(None, AXIS)
    program = _sharded(many, mesh, (SPREAD, over_envs, over_envs), (SPREAD, over_envs))
    run = _waiting(program, drones, speeds, turns)
    return Workload(run, num_envs * num_steps, "control steps/s")


def _poses(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 3) in the rooms and nearly level attitudes (n, 4)."""
    draw = np.random.default_rng(0)
    places = np.column_stack([draw.uniform(-9, 7, (number, 2)), np.full(number, 1.2)])
    attitudes = np.column_stack(
        [np.ones(number), draw.normal(0, 0.1, (number, 2)), draw.normal(0, 1, number)]
    )
    return places, attitudes / np.linalg.norm(attitudes, axis=1, keepdims=True)


def depth(scene: pecjax.Scene, mesh: Mesh, num_images: int) -> Workload:
    """Our depth images."""
    pixels = scene.camera.height * scene.camera.width
    program = _sharded(jax.vmap(partial(depth_image, scene)), mesh, (SPREAD, SPREAD), SPREAD)
    poses = [jnp.asarray(pose, jnp.float32) for pose in _poses(num_images)]
    return Workload(_waiting(program, *poses), num_images * pixels, "rays/s")


def c_depth(scene: pecjax.Scene, num_images: int) -> Workload:
    """`mj_multiRay` on every core, one call an image."""
    local = pixel_directions(scene.camera).reshape(-1, 3)
    places, attitudes = _poses(num_images)
    drone = scene.model.body("drone").id
    number = len(local)

    def images(core: int) -> None:
        data = mujoco.MjData(scene.model)
        mujoco.mj_kinematics(scene.model, data)
        ids, distances, rotation = np.zeros(number, np.int32), np.zeros(number), np.zeros(9)
        for place, attitude in zip(places[core :: num_cores()], attitudes[core :: num_cores()], strict=True):
            mujoco.mju_quat2Mat(rotation, attitude)
            rays = (local @ rotation.reshape(3, 3).T).ravel()
            mujoco.mj_multiRay(
                scene.model, data, place, rays, None, True, drone, ids, distances, None, number, 10.0
            )

    pool = ThreadPoolExecutor(num_cores())
    return Workload(lambda: list(pool.map(images, range(num_cores()))), num_images * number, "rays/s")


def mjx_depth(scene: pecjax.Scene, mesh: Mesh, num_images: int) -> Workload:
    """`mjx.ray`, batched over rays and images."""
    local = jnp.asarray(pixel_directions(scene.camera).reshape(-1, 3), jnp.float32)
    # mjx.ray reads materials, and fails on a model that has none.
    spec = mujoco.MjSpec.from_string(
        "<mujoco><asset><material name='m'/></asset><worldbody>"
        + "".join(
            f"<geom type='box' material='m' pos='{' '.join(map(str, (lo + hi) / 2))}' "
            f"size='{' '.join(map(str, (hi - lo) / 2))}'/>"
            for lo, hi in zip(scene.wall_lower, scene.wall_upper, strict=True)
        )
        + "</worldbody></mujoco>"
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    physics, posed = mjx.put_model(model), mjx.put_data(model, data)

    def image(place, attitude):
        rotation = pecjax.world.rotations.quaternion_to_matrix(attitude)
        return jax.vmap(lambda ray: mjx.ray(physics, posed, place, rotation @ ray)[0])(local)

    program = _sharded(jax.vmap(image), mesh, (SPREAD, SPREAD), SPREAD)
    poses = [jnp.asarray(pose, jnp.float32) for pose in _poses(num_images)]
    return Workload(_waiting(program, *poses), num_images * len(local), "rays/s")


def environment(
    env: pecjax.RoomsNavigation, sampler: Sampler, mesh: Mesh, num_envs: int, num_steps: int
) -> Workload:
    """Our environment under random actions: flight, depth, reward, endings, resets, draws, tally."""
    table = env.configurations

    def random_actions(obs, chance):
        return (chance * env.action_size).astype(jnp.int32), ()

    def batch(fleet, sampler_state, key):
        num_local = fleet.config_id.shape[0]
        ids = jax.lax.axis_index(AXIS) * num_local + jnp.arange(num_local)
        fleet, trajectory, episodes = rollout(
            env, table, sampler, sampler_state, random_actions, fleet, key, ids, num_steps
        )
        # A sum over every image, so that none is optimised away.
        seen = jax.lax.psum(trajectory.obs["depth"].sum() + trajectory.reward.sum(), AXIS)
        return fleet, sampler.update(sampler_state, episodes.outcomes, AXIS), seen

    program = _sharded(batch, mesh, (SPREAD, SAME, SAME), (SPREAD, SAME, SAME))
    key = jax.random.key(0)
    begin = jax.jit(partial(launch, env, table, sampler, num_envs=num_envs))
    fleet = begin(sampler_state=sampler.init(), key=key)
    carry = [jax.device_put(fleet, jax.NamedSharding(mesh, SPREAD)), sampler.init(), 0]

    def run() -> None:
        carry[2] += 1
        fleet, state, seen = program(carry[0], carry[1], env_keys(key, jnp.array([carry[2]]))[0])
        carry[:2] = fleet, state
        jax.block_until_ready(seen)

    return Workload(run, num_envs * num_steps, "control steps/s")


def training(
    env: pecjax.RoomsNavigation,
    sampler: Sampler,
    mesh: Mesh,
    settings: ppo_update.PPOSettings | apex_update.ApexSettings,
) -> Workload:
    """PPO or Ape-X end to end, Ape-X once its replay is warm."""
    if isinstance(settings, apex_update.ApexSettings):
        settings = dataclasses.replace(settings, learning_starts=0)
        agent = apex.make(env, env.configurations, sampler, settings, AXIS)
    else:
        agent = ppo.make(env, env.configurations, sampler, settings, AXIS)
    agent = shard(agent, mesh)
    carry = [agent.init(jax.random.key(0))]
    iterate = jax.jit(agent.iterate, donate_argnums=0)

    def run() -> None:
        carry[0], metrics = iterate(carry[0])
        jax.block_until_ready(metrics)

    return Workload(run, agent.steps_per_iteration, "control steps/s")


def learner(
    env: pecjax.RoomsNavigation, mesh: Mesh, settings: ppo_update.PPOSettings
) -> tuple[Workload, Workload]:
    """The policy's step (forward and draw) and the update, on made-up batches."""
    camera = env.scene.camera
    network = ActorCritic(settings.network, env.action_size, (camera.height, camera.width))
    key = jax.random.key(0)
    shape = (settings.num_steps, settings.num_envs)
    obs = {
        "depth": jax.random.uniform(key, (*shape, camera.height, camera.width), maxval=camera.far),
        "goal": jax.random.normal(key, (*shape, 2)),
    }
    features = encode(obs, camera.far)
    params = network.init(key, features[0, :1])
    optimizer = ppo_update.make_optimizer(settings)
    state = ppo_update.Learner(params, optimizer.init(params), jnp.float32(0))
    logits, value = jax.jit(lambda f: forward(network, params, f))(features)
    action = jax.random.randint(key, shape, 0, env.action_size)
    reward = jax.random.normal(key, shape)
    trajectory = Trajectory(None, action, reward, reward > 2, (features, logits, value))

    def act(params, obs, key):
        chances = jax.random.uniform(key, obs["goal"].shape[:2])

        def step(_, row):
            obs, chance = row
            logits, _ = forward(network, params, encode(obs, camera.far))
            return None, draw_action(logits, chance)

        return jax.lax.scan(step, None, (obs, chances))[1]

    def update(state, trajectory, key):
        batch = ppo_update.prepare(settings, trajectory, trajectory.reward[0], AXIS)
        return ppo_update.update(network, optimizer, settings, state, batch, key, AXIS)

    over_envs = PartitionSpec(None, AXIS)
    policy = _sharded(act, mesh, (SAME, over_envs, SAME), over_envs)
    learn = _sharded(update, mesh, (SAME, over_envs, SAME), SAME)
    amount = settings.num_steps * settings.num_envs
    return (
        Workload(_waiting(policy, params, obs, key), amount, "control steps/s"),
        Workload(_waiting(learn, state, trajectory, key), amount, "control steps/s"),
    )


def curriculum(sampler: Sampler, num_configs: int, draws: int) -> tuple[Workload, Workload]:
    """A draw and a tally of so many episodes, and a plain copy of the counts to hold it against."""

    def draw_and_tally(state, key):
        ids = sampler.sample(state, key, (draws,))
        return sampler.update(state, Outcomes(ids, jnp.ones(draws, bool), ids % 3 == 0))

    program = jax.jit(draw_and_tally)
    counts = jnp.zeros((2, num_configs), jnp.int32)
    copy = jax.jit(lambda counts: counts + 1)
    run = _waiting(program, sampler.init(), jax.random.key(0))
    return Workload(run, 1, "times/s"), Workload(_waiting(copy, counts), 1, "times/s")


REPLAY_ENVS, REPLAY_STEPS, REPLAY_DRAWS, N_STEP = 128, 2, 512, 3


def replay_parts(capacity: int) -> dict[str, Workload]:
    """One shard of so many transitions with 16×12 images: adding, drawing and new priorities."""
    settings = replay.ReplaySettings(capacity=capacity)
    shape = (REPLAY_STEPS, REPLAY_ENVS)
    number = jnp.zeros(shape)
    frame = replay.Frame(jnp.zeros((*shape, 192), jnp.uint8), jnp.zeros((*shape, 2)))
    rows = replay.Rows(frame, number.astype(jnp.int32), number, number, number + 1)

    def draw(shard: replay.Replay, key: jax.Array) -> tuple[replay.Replay, jax.Array]:
        batch = replay.sample(settings, shard, key, REPLAY_DRAWS, REPLAY_ENVS, N_STEP)
        # A sum over every image, so that none is optimised away.
        seen = batch.frame.depth.sum() + batch.next_frame.depth.sum() + batch.weight.sum()
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
        shard = replay.empty(capacity // REPLAY_ENVS, REPLAY_ENVS, 192)
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


def device_mesh(num_devices: int | None = None) -> Mesh:
    """All devices, or the first few."""
    return fleet_mesh(num_devices or len(jax.devices()))
