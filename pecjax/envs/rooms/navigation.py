"""Navigation: the task of flying from start to goal through the rooms, as a Brax environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from brax.envs.base import Env, State

from pecjax.envs.rooms.config import COORDINATE_SET_1, Configurations
from pecjax.envs.rooms.depth import depth_image
from pecjax.envs.rooms.flight import Command, ControllerGains, DroneState, fly, hover
from pecjax.envs.rooms.rotations import heading
from pecjax.envs.rooms.scene import Scene
from pecjax.errors import InputError

MAX_PHYSICS_STEPS = 1000  # in one control period
SPEEDS = (0.0, 1.0, 2.0)  # m/s
YAW_RATES = (-np.pi / 2, -np.pi / 4, 0.0, np.pi / 4, np.pi / 2)  # rad/s


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
        standing_reward: further paid at every action once the speed asked for has been 0 for
            more than `standing_limit` actions in a row.
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
    standing_reward: float = -3.0
    standing_limit: int = 10
    gains: ControllerGains = ControllerGains()


class FlightState(NamedTuple):
    """All that an episode carries from action to action.

    It is the `pipeline_state` of a Brax state, the part that Brax's own automatic reset restores.

    Attributes:
        qpos: (7,) position m and attitude quaternion w-x-y-z, in the world.
        qvel: (6,) velocity m/s in the world, body rates rad/s in the drone's frame.
        config: the episode's configuration, one row of a table.
        step_count: () int32, actions taken.
        standing_count: () int32, of these the last in a row that asked for no speed.
    """

    qpos: jax.Array
    qvel: jax.Array
    config: Configurations
    step_count: jax.Array
    standing_count: jax.Array


def flight_state(state: State) -> FlightState:
    """The flight within a Brax state."""
    return cast(FlightState, state.pipeline_state)


def observation(state: State) -> dict[str, jax.Array]:
    """The observation within a Brax state."""
    return cast(dict[str, jax.Array], state.obs)


class RoomsNavigation(Env):
    """Fly to the goal by depth camera, without touching a wall.

    Brax's contract for a single environment: batch it with `jax.vmap`. An action is an int in
    [0, 15): 5 × speed index + yaw-rate index, over `SPEEDS` and `YAW_RATES` (2 stands still,
    12 flies straight ahead at 2 m/s). The observation is a dict of `depth` (H, W) m and `goal`
    (2,): level distance to the goal in m, and its bearing off the heading in rad, in [-π, π),
    positive to the left. `pipeline_state` is a `FlightState`; `metrics` says which ending came
    about: `goal`, `collision`, `timeout`, each 0 or 1, and `unstable` where physics blew up, a
    collision too. A step keeps whatever else wrappers have put into `metrics` and `info`.

    The environment never resets itself: draw a configuration and call `reset_to`. Under
    `brax.envs.training.wrap`, a reset repeats each environment's first configuration.
    """

    def __init__(
        self,
        scene: Scene,
        configurations: Configurations = COORDINATE_SET_1,
        settings: NavigationSettings = NavigationSettings(),
    ) -> None:
        """Builds the environment; `configurations` is what `reset` draws from, uniformly."""
        ratio = settings.control_period / max(scene.model.opt.timestep, 1e-9)
        self.physics_steps = round(ratio)
        if not 1 <= self.physics_steps <= MAX_PHYSICS_STEPS or abs(ratio - self.physics_steps) > 1e-6:
            raise InputError(
                f"control period {settings.control_period} s is not a multiple of the scene's timestep "
                f"{scene.model.opt.timestep} s, or more than {MAX_PHYSICS_STEPS} times it; change either"
            )
        self.scene = scene
        self.configurations = configurations
        self.settings = settings

    def reset(self, rng: jax.Array) -> State:
        """Starts an episode in a configuration drawn uniformly from the table."""
        rng_row, rng = jax.random.split(rng)
        row = jax.random.randint(rng_row, (), 0, self.configurations.size)
        return self.reset_to(jax.tree.map(lambda leaf: jnp.asarray(leaf)[row], self.configurations), rng)

    def reset_to(self, config: Configurations, rng: jax.Array) -> State:
        """Starts an episode in `config`, one row of a table, with a uniform random heading."""
        return self.observe(self.place(config, jax.random.uniform(rng, minval=-jnp.pi, maxval=jnp.pi)))

    def step(self, state: State, action: jax.Array) -> State:
        """One control period under `action`. What follows an ending is undefined: reset."""
        return self.observe(self.advance(state, action))

    def place(self, config: Configurations, heading: jax.Array) -> State:
        """`reset_to` with the heading (rad) given and the observation left for `observe`."""
        height = jnp.full(1, self.settings.flight_height)
        drone = hover(jnp.concatenate([config.start, height]), heading)
        zero, no_steps = jnp.zeros(()), jnp.zeros((), jnp.int32)
        return State(
            pipeline_state=cast(Any, FlightState(drone.qpos, drone.qvel, config, no_steps, no_steps)),
            obs={},
            reward=zero,
            done=zero,
            metrics={"goal": zero, "collision": zero, "timeout": zero, "unstable": zero},
        )

    def advance(self, state: State, action: jax.Array) -> State:
        """`step` with the observation left for `observe`: physics, endings and reward."""
        settings = self.settings
        speed = jnp.asarray(SPEEDS, jnp.float32)[action // len(YAW_RATES)]
        yaw_rate = jnp.asarray(YAW_RATES, jnp.float32)[action % len(YAW_RATES)]
        flight = flight_state(state)
        before = DroneState(flight.qpos, flight.qvel)
        drone, nearest = fly(
            self.scene,
            settings.gains,
            before,
            Command(speed, yaw_rate, settings.flight_height),
            self.physics_steps,
        )
        # Physics that has blown up counts as a collision, and goes no further than this episode.
        unstable = ~jnp.all(jnp.abs(jnp.concatenate(drone)) < mujoco.mjMAXVAL)
        drone = jax.tree.map(lambda old, new: jnp.where(unstable, old, new), before, drone)
        step_count = flight.step_count + 1
        standing_count = (speed == 0) * (flight.standing_count + 1)

        collision = (nearest <= self.scene.drone_radius) | unstable
        distance = jnp.linalg.norm(flight.config.goal - drone.qpos[:2])
        goal = (distance < settings.goal_radius) & ~collision
        timeout = (step_count >= settings.max_steps) & ~goal & ~collision
        reward = (
            settings.step_reward
            + settings.goal_reward * goal
            + settings.collision_reward * collision
            + settings.timeout_reward * timeout
            + settings.standing_reward * (standing_count > settings.standing_limit)
        )
        endings = {"goal": goal, "collision": collision, "timeout": timeout, "unstable": unstable}
        return state.replace(
            pipeline_state=FlightState(drone.qpos, drone.qvel, flight.config, step_count, standing_count),
            reward=jnp.asarray(reward, jnp.float32),
            done=(goal | collision | timeout).astype(jnp.float32),
            metrics=state.metrics | {name: came.astype(jnp.float32) for name, came in endings.items()},
        )

    def observe(self, state: State) -> State:
        """Fills in the observation of the state as it stands."""
        flight = flight_state(state)
        offset = flight.config.goal - flight.qpos[:2]
        bearing = jnp.arctan2(offset[1], offset[0]) - heading(flight.qpos[3:])
        goal = jnp.stack([jnp.linalg.norm(offset), (bearing + jnp.pi) % (2 * jnp.pi) - jnp.pi])
        depth = depth_image(self.scene, flight.qpos[:3], flight.qpos[3:])
        return state.replace(obs={"depth": depth, "goal": goal})

    @property
    def dt(self) -> float:
        """Seconds between actions."""
        return self.settings.control_period

    @property
    def observation_size(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the observation's parts."""
        camera = self.scene.camera
        return {"depth": (camera.height, camera.width), "goal": (2,)}

    @property
    def action_size(self) -> int:
        """15: every speed with every yaw rate."""
        return len(SPEEDS) * len(YAW_RATES)

    @property
    def backend(self) -> str:
        """The physics engine's name."""
        return "mjx"
