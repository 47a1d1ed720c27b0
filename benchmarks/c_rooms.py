"""CRooms: the task over C MuJoCo as a vector environment of Stable-Baselines3."""

from __future__ import annotations

import jax
import mujoco
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

import pecjax
from pecjax.envs.rooms.clearance import wall_distance
from pecjax.envs.rooms.controller import Command
from pecjax.envs.rooms.depth import pixel_directions
from pecjax.envs.rooms.flight import DroneState, rotor_controls
from pecjax.envs.rooms.sensing import DISTANCE_SCALE
from pecjax.envs.rooms.task import SPEEDS, YAW_RATES


class CRooms(VecEnv):
    """N drones in one process: C physics and rays; our controller, jitted over all of them."""

    def __init__(self, env: pecjax.RoomsNavigation, num_envs: int) -> None:
        """Builds N simulations of the environment's own scene."""
        task, vehicle, walls = env.task, env.scene.vehicle, env.scene.walls
        self._scene, self._settings, self._steps = env.scene, task.settings, task.physics_steps
        self._camera, self._radius = vehicle.camera, vehicle.radius
        self._table = jax.tree.map(np.asarray, env.configurations)
        self._datas = [mujoco.MjData(env.scene.model) for _ in range(num_envs)]
        self._drone = env.scene.model.body("drone").id
        self._rays = pixel_directions(self._camera).reshape(-1, 3)
        self._draw = np.random.default_rng(0)
        gains = task.settings.gains
        self._control = jax.jit(
            jax.vmap(lambda state, command: rotor_controls(vehicle, gains, state, command))
        )
        self._clearance = jax.jit(lambda points: wall_distance(walls, points))
        self._goal = np.zeros((num_envs, 2))
        self._age, self._hovering = np.zeros(num_envs, int), np.zeros(num_envs, int)
        space = spaces.Box(-np.inf, np.inf, (len(self._rays) + 3,), np.float32)
        super().__init__(num_envs, space, spaces.Discrete(len(SPEEDS) * len(YAW_RATES)))

    def _place(self, i: int) -> None:
        row = self._draw.integers(self._table.start.shape[0])
        heading = self._draw.uniform(-np.pi, np.pi)
        data = self._datas[i]
        mujoco.mj_resetData(self._scene.model, data)
        data.qpos[:3] = (*self._table.start[row], self._settings.flight_height)
        data.qpos[3:] = (np.cos(heading / 2), 0, 0, np.sin(heading / 2))
        mujoco.mj_kinematics(self._scene.model, data)
        self._goal[i] = self._table.goal[row]
        self._age[i] = self._hovering[i] = 0

    def _observe(self) -> np.ndarray:
        camera, number = self._camera, len(self._rays)
        obs = np.empty((self.num_envs, number + 3), np.float32)
        ids, distances = np.zeros(number, np.int32), np.zeros(number)
        for i, data in enumerate(self._datas):
            rotation = np.zeros(9)
            mujoco.mju_quat2Mat(rotation, data.qpos[3:])
            rotation = rotation.reshape(3, 3)
            eye = data.qpos[:3] + rotation @ camera.position
            rays = (self._rays @ rotation.T).ravel()
            mujoco.mj_multiRay(
                self._scene.model,
                data,
                eye,
                rays,
                None,
                True,
                self._drone,
                ids,
                distances,
                None,
                number,
                20.0,
            )
            obs[i, :-3] = np.where(distances < 0, camera.far, np.clip(distances, camera.near, camera.far))
            offset = self._goal[i] - data.qpos[:2]
            bearing = np.arctan2(offset[1], offset[0]) - np.arctan2(rotation[1, 0], rotation[0, 0])
            obs[i, -3:] = np.linalg.norm(offset) / DISTANCE_SCALE, np.sin(bearing), np.cos(bearing)
        obs[:, :-3] /= camera.far
        return obs

    def reset(self) -> np.ndarray:
        """Starts every drone anew."""
        for i in range(self.num_envs):
            self._place(i)
        return self._observe()

    def step_async(self, actions: np.ndarray) -> None:
        """Remembers the actions."""
        self._actions = actions

    def step_wait(self):
        """One control step of every drone."""
        settings = self._settings
        speed = np.asarray(SPEEDS, np.float32)[self._actions // len(YAW_RATES)]
        turn = np.asarray(YAW_RATES, np.float32)[self._actions % len(YAW_RATES)]
        command = Command(speed, turn, np.full_like(speed, settings.flight_height))
        near = np.full(self.num_envs, np.inf)
        for _ in range(self._steps):
            qpos = np.array([data.qpos for data in self._datas], np.float32)
            qvel = np.array([data.qvel for data in self._datas], np.float32)
            controls = np.asarray(self._control(DroneState(qpos, qvel), command))
            for data, control in zip(self._datas, controls, strict=True):
                data.ctrl[:] = control
                mujoco.mj_step(self._scene.model, data)
            places = np.array([data.qpos[:3] for data in self._datas], np.float32)
            near = np.minimum(near, np.asarray(self._clearance(places)))
        self._age += 1
        self._hovering = np.where(speed == 0, self._hovering + 1, 0)
        hit = near <= self._radius
        reached = (np.linalg.norm(self._goal - places[:, :2], axis=1) < settings.goal_radius) & ~hit
        late = (self._age >= settings.max_steps) & ~hit & ~reached
        reward = settings.step_reward + settings.goal_reward * reached + settings.collision_reward * hit
        reward += settings.timeout_reward * late
        reward -= settings.hover_penalty * (self._hovering > settings.hover_limit)
        done = hit | reached | late
        for i in np.flatnonzero(done):
            self._place(i)
        # PPO wants the last observation of episodes that were cut off alone, and none here is.
        infos = [{} for _ in range(self.num_envs)]
        return self._observe(), (reward * 1e-3).astype(np.float32), done, infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name, indices=None):
        """The same for all."""
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        """Not needed."""

    def env_method(self, method_name, *args, indices=None, **kwargs):
        """Not needed."""
        return [None] * self.num_envs

    def env_is_wrapped(self, wrapper_class, indices=None):
        """Never."""
        return [False] * self.num_envs
