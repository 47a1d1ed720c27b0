"""Workloads: prepared pieces of the world's work, whose calls can be timed in turn."""

from __future__ import annotations

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
from pecjax import agents
from pecjax.agents import AXIS
from pecjax.agents.rollout import Policy, init_rollout, rollout
from pecjax.agents.sharding import env_keys, global_ids
from pecjax.curriculum import Sampler
from pecjax.envs.rooms import RoomsTask
from pecjax.envs.rooms.controller import Command
from pecjax.envs.rooms.depth import depth_image, pixel_directions
from pecjax.envs.rooms.flight import fly, hover
from pecjax.envs.rooms.rotations import quaternion_to_matrix
from pecjax.envs.task import Task, World
from pecjax.runtime.devices import num_cores
from pecjax.training.build import everywhere

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


def sharded(function: Callable, mesh: Mesh, in_specs: tuple, out_specs: object) -> Callable:
    """A compiled program over all devices of the mesh."""
    return jax.jit(
        jax.shard_map(function, mesh=mesh, in_specs=in_specs, out_specs=out_specs, check_vma=False)
    )


def waiting(function: Callable, *args: object) -> Callable[[], object]:
    """A call that ends when its results are there."""
    return lambda: jax.block_until_ready(function(*args))


def c_physics(scene: pecjax.Scene, num_envs: int, num_steps: int) -> Workload:
    """C MuJoCo's `rollout` on every core: the same model and physics steps, and nothing else."""
    model, steps = scene.model, RoomsTask(scene.vehicle).physics_steps
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    initial = np.tile(state, (num_envs, 1))
    hovering = scene.vehicle.mass * 9.81 / model.nu
    shape = (num_envs, num_steps * steps, model.nu)
    controls = np.random.default_rng(0).uniform(0.9 * hovering, 1.1 * hovering, shape)
    pool = c_rollout.Rollout(nthread=num_cores())
    threads = [mujoco.MjData(model) for _ in range(num_cores())]
    run = partial(pool.rollout, model, threads, initial, controls)
    return Workload(run, num_envs * num_steps, "control steps/s")


def flight(scene: pecjax.Scene, mesh: Mesh, num_envs: int, num_steps: int) -> Workload:
    """Our controller, physics and the distance to the walls."""
    task = RoomsTask(scene.vehicle)
    start = jnp.tile(jnp.array([0.0, -2.0, 1.2]), (num_envs, 1))
    drones = jax.vmap(hover)(start, jnp.linspace(-3, 3, num_envs))
    keys = jax.random.split(jax.random.key(0), 2)
    speeds = jax.random.uniform(keys[0], (num_steps, num_envs), maxval=2.0)
    turns = jax.random.uniform(keys[1], (num_steps, num_envs), minval=-1.5, maxval=1.5)

    def one(drone, speed, turn):
        command = Command(speed, turn, 1.2)
        return fly(scene.vehicle, scene.walls, task.settings.gains, drone, command, task.physics_steps)

    def many(drones, speeds, turns):
        return jax.lax.scan(lambda d, row: jax.vmap(one)(d, *row), drones, (speeds, turns))

    over_envs = PartitionSpec(None, AXIS)
    program = sharded(many, mesh, (SPREAD, over_envs, over_envs), (SPREAD, over_envs))
    run = waiting(program, drones, speeds, turns)
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
    camera = scene.vehicle.camera
    program = sharded(jax.vmap(partial(depth_image, scene)), mesh, (SPREAD, SPREAD), SPREAD)
    poses = [jnp.asarray(pose, jnp.float32) for pose in _poses(num_images)]
    return Workload(waiting(program, *poses), num_images * camera.height * camera.width, "rays/s")


def c_depth(scene: pecjax.Scene, num_images: int) -> Workload:
    """`mj_multiRay` on every core, one call an image."""
    local = pixel_directions(scene.vehicle.camera).reshape(-1, 3)
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
    local = jnp.asarray(pixel_directions(scene.vehicle.camera).reshape(-1, 3), jnp.float32)
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
        rotation = quaternion_to_matrix(attitude)
        return jax.vmap(lambda ray: mjx.ray(physics, posed, place, rotation @ ray)[0])(local)

    program = sharded(jax.vmap(image), mesh, (SPREAD, SPREAD), SPREAD)
    poses = [jnp.asarray(pose, jnp.float32) for pose in _poses(num_images)]
    return Workload(waiting(program, *poses), num_images * len(local), "rays/s")


def environment(
    task: Task, world: World, sampler: Sampler, mesh: Mesh, num_envs: int, num_steps: int
) -> Workload:
    """Our environment under random actions: flight, depth, reward, endings, resets, draws, counts."""

    def random_actions(seen, chance):
        return (chance * task.action_space.num_actions).astype(jnp.int32), None, ()

    policy = Policy(jax.random.uniform, random_actions, lambda seen: jnp.zeros(num_envs))

    def batch(world, envs, sampler_state, key):
        ids = global_ids(envs.running.length.shape[0], AXIS)
        envs, trajectory, episodes = rollout(
            task, world, sampler, sampler_state, policy, envs, key, ids, num_steps
        )
        # A sum over every image, so that none is optimised away.
        seen = jax.lax.psum(trajectory.obs["depth"].sum() + trajectory.reward.sum(), AXIS)
        return envs, sampler.update(sampler_state, episodes.outcomes, AXIS), seen

    program = sharded(batch, mesh, (SAME, SPREAD, SAME, SAME), (SPREAD, SAME, SAME))
    key, world = jax.random.key(0), everywhere(world, mesh)
    begin = jax.jit(lambda world, state: init_rollout(task, world, sampler, state, key, num_envs))
    envs = begin(world, sampler.init())
    carry = [jax.device_put(envs, jax.NamedSharding(mesh, SPREAD)), sampler.init(), 0]

    def run() -> None:
        carry[2] += 1
        envs, state, seen = program(world, carry[0], carry[1], env_keys(key, jnp.array([carry[2]]))[0])
        carry[:2] = envs, state
        jax.block_until_ready(seen)

    return Workload(run, num_envs * num_steps, "control steps/s")


def device_mesh(num_devices: int | None = None) -> Mesh:
    """All devices, or the first few."""
    return agents.device_mesh(num_devices or len(jax.devices()))
