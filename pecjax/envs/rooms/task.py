"""The task of flying from start to goal through the rooms (Jang & Choi 2022, §4.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from pecjax.envs.rooms.air import first_gust, next_gust
from pecjax.envs.rooms.camera_errors import with_errors
from pecjax.envs.rooms.config import MAX_LATENCY, Configurations
from pecjax.envs.rooms.flight import Command, Conditions, ControllerGains, DroneState, fly, hover
from pecjax.envs.rooms.maps import MapBank, pick
from pecjax.envs.rooms.sensing import scale, sense
from pecjax.envs.rooms.vehicle import Vehicle
from pecjax.envs.spaces import Box, Discrete
from pecjax.envs.task import Task, Transition
from pecjax.errors import InputError

MAX_PHYSICS_STEPS = 1000  # in one control period
SPEEDS = (0.0, 1.0, 2.0)  # m/s
YAW_RATES = (-np.pi / 2, -np.pi / 4, 0.0, np.pi / 4, np.pi / 2)  # rad/s
STAND_STILL = 2  # the action


@dataclass(frozen=True)
class NavigationSettings:
    """Settings of the task; rewards and endings are those of Jang & Choi (2022), §4.1.

    Attributes:
        control_period: s between actions, a multiple of the physics step.
        flight_height: m.
        goal_radius: m, level distance within which the goal counts as reached.
        max_steps: actions after which an episode has failed.
        goal_reward, collision_reward, timeout_reward: paid once, at the end.
        step_reward: paid at every action.
        hover_penalty: taken off at every action once the speed asked for has been 0 for more than
            `hover_limit` actions in a row.
        drag: N s²/m² along the drone's own axes, where there is air (see `air.drag_force`); those of
            hector_quadrotor.
        gust_time: s, after which the correlation of a gust has fallen to 1/e.
        gains: of the velocity controller.
    """

    control_period: float = 0.1
    flight_height: float = 1.2
    goal_radius: float = 0.5
    max_steps: int = 1000
    goal_reward: float = 2000.0
    collision_reward: float = -1000.0
    timeout_reward: float = -1000.0
    step_reward: float = -1.0
    hover_penalty: float = 3.0
    hover_limit: int = 10
    drag: tuple[float, float, float] = (0.12, 0.12, 0.1)
    gust_time: float = 1.0
    gains: ControllerGains = ControllerGains()


class RoomsParams(NamedTuple):
    """What all episodes share.

    Attributes:
        bank: the maps.
    """

    bank: MapBank


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
    """

    qpos: jax.Array
    qvel: jax.Array
    config: Configurations
    step_count: jax.Array
    hover_count: jax.Array
    gust: jax.Array | None = None
    pending: jax.Array | None = None


class RoomsTask(Task):
    """Fly to the goal by depth camera, without touching a wall.

    An action is an int in [0, 15): 5 × speed index + yaw-rate index, over `SPEEDS` and `YAW_RATES`
    (2 stands still, 12 flies straight ahead at 2 m/s). A step limit is an ending of the task: it is a
    failure, and is paid for. `sensing.scale` says what is observed.
    """

    metrics: ClassVar = {"collision": "last", "timeout": "last", "unstable": "last"}

    def __init__(self, vehicle: Vehicle, settings: NavigationSettings = NavigationSettings()) -> None:
        """Puts drone and rules together.

        Raises:
            InputError: a control period that is no multiple of the physics step, negative drag, or gusts
                of no duration.
        """
        ratio = settings.control_period / max(vehicle.timestep, 1e-9)
        self.physics_steps = round(ratio)
        if not 1 <= self.physics_steps <= MAX_PHYSICS_STEPS or abs(ratio - self.physics_steps) > 1e-6:
            raise InputError(
                f"control period {settings.control_period} s is not a multiple of the scene's timestep "
                f"{vehicle.timestep} s, or more than {MAX_PHYSICS_STEPS} times it; change either"
            )
        if len(settings.drag) != 3 or min(settings.drag) < 0 or settings.gust_time <= 0:
            raise InputError(
                f"drag is {settings.drag}, gust-time {settings.gust_time}; give three numbers that are not "
                "negative, and a time above 0"
            )
        self.vehicle = vehicle
        self.settings = settings
        camera = vehicle.camera
        self.observation_space = {
            "depth": Box((camera.height, camera.width), camera.near / camera.far, 1.0),
            "goal": Box((3,)),
        }
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
        return RoomsState(drone.qpos, drone.qvel, config, none, none, still, pending)

    def step(self, key: jax.Array, state: RoomsState, action: jax.Array, params: RoomsParams) -> Transition:
        """One control period: physics, endings and reward.

        Physics that has blown up is `unstable`; it counts as a collision, and goes no further than this
        episode.
        """
        settings, config, gust, pending = self.settings, state.config, state.gust, state.pending
        if pending is not None:
            queue = jnp.concatenate([jnp.asarray(action, jnp.int32)[None], pending])
            action, pending = queue[config.latency], queue[:-1]
        speed = jnp.asarray(SPEEDS, jnp.float32)[action // len(YAW_RATES)]
        yaw_rate = jnp.asarray(YAW_RATES, jnp.float32)[action % len(YAW_RATES)]
        before = DroneState(state.qpos, state.qvel)
        drone, nearest = fly(
            self.vehicle,
            pick(params.bank, config.map_id),
            settings.gains,
            before,
            Command(speed, yaw_rate, settings.flight_height),
            self.physics_steps,
            Conditions(_air(config.wind, gust), settings.drag, config.payload, config.motor_strength),
        )
        if gust is not None:
            gust = next_gust(key, gust, config.gust, settings.control_period, settings.gust_time)
        unstable = ~jnp.all(jnp.abs(jnp.concatenate(drone)) < mujoco.mjMAXVAL)
        drone = jax.tree.map(lambda old, new: jnp.where(unstable, old, new), before, drone)
        step_count = state.step_count + 1
        hover_count = (speed == 0) * (state.hover_count + 1)

        collision = (nearest <= self.vehicle.radius) | unstable
        distance = jnp.linalg.norm(config.goal - drone.qpos[:2])
        goal = (distance < settings.goal_radius) & ~collision
        timeout = (step_count >= settings.max_steps) & ~goal & ~collision
        reward = (
            settings.step_reward
            + settings.goal_reward * goal
            + settings.collision_reward * collision
            + settings.timeout_reward * timeout
            - settings.hover_penalty * (hover_count > settings.hover_limit)
        )
        return Transition(
            state=RoomsState(drone.qpos, drone.qvel, config, step_count, hover_count, gust, pending),
            reward=jnp.asarray(reward, jnp.float32),
            terminated=goal | collision | timeout,
            truncated=jnp.zeros((), bool),
            success=goal,
            metrics={"collision": collision, "timeout": timeout, "unstable": unstable},
        )

    def observe(self, key: jax.Array, state: RoomsState, params: RoomsParams) -> dict[str, jax.Array]:
        """Depth image and goal, scaled (see `sensing.scale`)."""
        return scale(self.sense(key, state, params), self.vehicle.camera.far)

    def sense(self, key: jax.Array, state: RoomsState, params: RoomsParams) -> dict[str, jax.Array]:
        """Depth image and goal in SI units (see `sensing.sense`)."""
        walls = pick(params.bank, state.config.map_id)
        seen = sense(self.vehicle.camera, walls, state.qpos[:3], state.qpos[3:], state.config.goal)
        return seen | {"depth": with_errors(self.vehicle.camera, state.config, key, seen["depth"])}

    def position(self, state: RoomsState) -> jax.Array:
        """(2,) m, seen from above."""
        return state.qpos[..., :2]


def _air(wind: jax.Array | None, gust: jax.Array | None) -> jax.Array | None:
    """The air's velocity (3,) m/s, None where there is none."""
    if wind is None or gust is None:
        return gust if wind is None else wind
    return wind + gust
