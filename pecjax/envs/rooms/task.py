"""The task of flying from start to goal through the rooms (Jang & Choi 2022, §4.1)."""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from pecjax.envs.rooms import privileged
from pecjax.envs.rooms.air import first_gust, next_gust
from pecjax.envs.rooms.camera_errors import with_errors
from pecjax.envs.rooms.config import MAX_LATENCY, OBJECTIVES, REACH, Configurations
from pecjax.envs.rooms.controller import Command
from pecjax.envs.rooms.flight import Conditions, DroneState, fly, hover
from pecjax.envs.rooms.maps import MapBank, pick
from pecjax.envs.rooms.objectives import advance, first_progress, is_holding, one_hot, target
from pecjax.envs.rooms.path_fields import PathFields, path_from
from pecjax.envs.rooms.rotations import heading
from pecjax.envs.rooms.rules import NavigationSettings, physics_steps
from pecjax.envs.rooms.sensing import scale, sense
from pecjax.envs.rooms.vehicle import Vehicle
from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, Transition
from pecjax.errors import InputError

SPEEDS = (0.0, 1.0, 2.0)  # m/s
YAW_RATES = (-np.pi / 2, -np.pi / 4, 0.0, np.pi / 4, np.pi / 2)  # rad/s
STAND_STILL = 2  # the action


class RoomsParams(NamedTuple):
    """What all episodes share.

    Attributes:
        bank: the maps.
        paths: to the goals, where a critic is told of them; None unless `for_training` has added them.
    """

    bank: MapBank
    paths: PathFields | None = None


class RoomsState(NamedTuple):
    """All that an episode carries from action to action.

    Attributes:
        qpos: (7,) position m and attitude quaternion w-x-y-z, in the world.
        qvel: (6,) velocity m/s in the world, body rates rad/s in the drone's frame.
        config: the episode's configuration, one row of a table.
        step_count: () int32, actions taken.
        hover_count: () int32, of these the last in a row that asked for no speed.
        gust: (3,) m/s, the air's velocity beyond the mean wind; None without gusts.
        pending: (`MAX_LATENCY`,) int32, the last actions, newest first; None without latency.
        progress: () int32, see `objectives.advance`; None without objectives.
    """

    qpos: jax.Array
    qvel: jax.Array
    config: Configurations
    step_count: jax.Array
    hover_count: jax.Array
    gust: jax.Array | None = None
    pending: jax.Array | None = None
    progress: jax.Array | None = None


class RoomsTask(Task):
    """Fly to the goal by depth camera, without touching a wall.

    An action is an int in [0, 15): 5 × speed index + yaw-rate index, over `SPEEDS` and `YAW_RATES`
    (2 stands still, 12 flies straight ahead at 2 m/s). A step limit is an ending of the task: it is a
    failure, and is paid for. `sensing.scale` says what is observed; where the table has objectives, the
    episode's is observed too, one-hot.
    """

    metrics: ClassVar = {"collision": "last", "timeout": "last", "unstable": "last", "path_length": "sum"}

    def __init__(
        self,
        vehicle: Vehicle,
        settings: NavigationSettings = NavigationSettings(),
        *,
        objectives: bool = False,
        one_map: bool = True,
        critic_paths: bool = False,
    ) -> None:
        """Puts drone and rules together.

        Args:
            objectives: whether its configurations have that axis.
            one_map: whether all its episodes share one map. Then the drone's place tells a critic where the
                walls are; otherwise critics are told nothing, unless it is of paths.
            critic_paths: whether critics are told of the shortest path to the goal, too.

        Raises:
            InputError: see `physics_steps`.
        """
        self.physics_steps = physics_steps(settings, vehicle.timestep)
        self.hold_steps = math.ceil(settings.hold_time / settings.control_period - 1e-6)
        self.vehicle = vehicle
        self.settings = settings
        camera = vehicle.camera
        self.observation_space = {
            "depth": Box((camera.height, camera.width), camera.near / camera.far, 1.0),
            "goal": Box((3,)),
        } | ({"objective": Box((len(OBJECTIVES),), 0.0, 1.0)} if objectives else {})
        self.privileged_space = privileged.space(critic_paths) if one_map or critic_paths else None
        self.critic_paths = critic_paths
        self.action_space = Discrete(len(SPEEDS) * len(YAW_RATES))
        self.max_steps = settings.max_steps

    def reset(self, key: jax.Array, config: Configurations, params: RoomsParams) -> RoomsState:
        """At the start, at rest, with the configuration's heading or a uniform random one."""
        drawn = jax.random.uniform(key, minval=-jnp.pi, maxval=jnp.pi)
        state = self.place(config, drawn if config.heading is None else config.heading)
        if config.gust is not None:
            state = state._replace(gust=first_gust(jax.random.fold_in(key, 1), config.gust))
        return state

    def place(self, config: Configurations, heading: jax.Array) -> RoomsState:
        """At the start, at rest, with this heading (rad), before any gust."""
        height = jnp.full(1, self.settings.flight_height)
        drone = hover(jnp.concatenate([config.start, height]), heading)
        none = jnp.zeros((), jnp.int32)
        still = None if config.gust is None else jnp.zeros(3)
        pending = None if config.latency is None else jnp.full(MAX_LATENCY, STAND_STILL, jnp.int32)
        return RoomsState(drone.qpos, drone.qvel, config, none, none, still, pending, first_progress(config))

    def step(self, key: jax.Array, state: RoomsState, action: jax.Array, params: RoomsParams) -> Transition:
        """One control period: physics, endings and reward.

        Physics that has blown up is `unstable`; it counts as a collision, and goes no further than this
        episode.
        """
        settings, config, gust, pending = self.settings, state.config, state.gust, state.pending
        if pending is not None:
            queue = jnp.concatenate([jnp.asarray(action, jnp.int32)[None], pending])
            action, pending = queue[config.latency], queue[:-1]
        command = self.command(action)
        before = DroneState(state.qpos, state.qvel)
        drone, nearest = fly(
            self.vehicle,
            pick(params.bank, config.map_id),
            settings.gains,
            before,
            command,
            self.physics_steps,
            Conditions(_air(config.wind, gust), settings.drag, config.payload, config.motor_strength),
        )
        if gust is not None:
            gust = next_gust(key, gust, config.gust, settings.control_period, settings.gust_time)
        unstable = ~jnp.all(jnp.abs(jnp.concatenate(drone)) < mujoco.mjMAXVAL)
        drone = jax.tree.map(lambda old, new: jnp.where(unstable, old, new), before, drone)
        step_count = state.step_count + 1
        collision = (nearest <= self.vehicle.radius) | unstable
        distance = jnp.linalg.norm(target(config, state.progress) - drone.qpos[:2])
        near = distance < settings.goal_radius
        progress, goal = advance(config, state.progress, near, self.hold_steps)
        goal &= ~collision
        timeout = (step_count >= settings.max_steps) & ~goal & ~collision
        idle = command.speed == 0
        if progress is not None:
            idle &= ~is_holding(config, progress)
        hover_count = idle * (state.hover_count + 1)
        reward = (
            settings.step_reward
            + settings.goal_reward * goal
            + settings.collision_reward * collision
            + settings.timeout_reward * timeout
            - settings.hover_penalty * (hover_count > settings.hover_limit)
        )
        return Transition(
            state=RoomsState(
                drone.qpos, drone.qvel, config, step_count, hover_count, gust, pending, progress
            ),
            reward=jnp.asarray(reward, jnp.float32),
            terminated=goal | collision | timeout,
            truncated=jnp.zeros((), bool),
            success=goal,
            metrics={
                "collision": collision,
                "timeout": timeout,
                "unstable": unstable,
                "path_length": jnp.linalg.norm(drone.qpos[:2] - before.qpos[:2]),
            },
        )

    def command(self, action: jax.Array) -> Command:
        """What an action asks of the controller."""
        speed = jnp.asarray(SPEEDS, jnp.float32)[action // len(YAW_RATES)]
        yaw_rate = jnp.asarray(YAW_RATES, jnp.float32)[action % len(YAW_RATES)]
        return Command(speed, yaw_rate, self.settings.flight_height)

    def observe(self, key: jax.Array, state: RoomsState, params: RoomsParams) -> dict[str, jax.Array]:
        """What `sense` gives, scaled (see `sensing.scale`)."""
        return scale(self.sense(key, state, params), self.vehicle.camera.far)

    def sense(self, key: jax.Array, state: RoomsState, params: RoomsParams) -> dict[str, jax.Array]:
        """Depth image and goal in SI units (see `sensing.sense`), and the objective if there are several."""
        walls = pick(params.bank, state.config.map_id)
        where = target(state.config, state.progress)
        seen = sense(self.vehicle.camera, walls, state.qpos[:3], state.qpos[3:], where)
        seen |= {"depth": with_errors(self.vehicle.camera, state.config, key, seen["depth"])}
        return seen if state.progress is None else seen | {"objective": one_hot(state.config)}

    def privileged(self, state: RoomsState, params: RoomsParams) -> dict[str, jax.Array]:
        """See `privileged.drone_numbers`; then the path (see `path_from`) where critics are told of it."""
        settings = self.settings
        late, idle = state.step_count / settings.max_steps, state.hover_count / max(settings.hover_limit, 1)
        numbers = privileged.drone_numbers(state.qpos, state.qvel, settings.flight_height, late, idle)
        if not self.critic_paths:
            return {"drone": numbers}
        if params.paths is None:  # as in evaluations, which only ask for the shape; a training would stop
            return {"drone": numbers, "path": jnp.full(3, jnp.nan)}
        where = target(state.config, state.progress)
        path = path_from(params.paths, state.config.map_id, where, state.qpos[:2], heading(state.qpos[3:]))
        return {"drone": numbers, "path": path}

    def fitted(self, table: Configurations) -> Configurations:
        """The table, with objectives if they are seen.

        Raises:
            InputError: it has objectives, and they are not seen.
        """
        if "objective" not in self.observation_space and table.objective is not None:
            if np.any(np.asarray(table.objective) != REACH):
                raise InputError(
                    "the configurations have objectives, which this policy was never shown; evaluate one "
                    "that was trained with them"
                )
            return table.replace(objective=None, waypoint=None)
        if "objective" in self.observation_space and table.objective is None:
            return table.replace(objective=np.full(table.size, REACH, np.int32))
        return table

    def pose(self, state: RoomsState) -> jax.Array:
        """Position m and attitude quaternion w-x-y-z of the drone, (7,)."""
        return state.qpos


def _air(wind: jax.Array | None, gust: jax.Array | None) -> jax.Array | None:
    """The air's velocity (3,) m/s, None where there is none."""
    if wind is None or gust is None:
        return gust if wind is None else wind
    return wind + gust
