"""The rooms as a Brax environment."""

from __future__ import annotations

from typing import Any, cast

import jax
import jax.numpy as jnp

from pecjax.envs.axes import fill
from pecjax.envs.rooms.config import COORDINATE_SET_1, Configurations, draws_on_the_way
from pecjax.envs.rooms.maps import make_bank
from pecjax.envs.rooms.quiet_mjx import Env, State
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.scene import Scene
from pecjax.envs.rooms.task import RoomsParams, RoomsState, RoomsTask
from pecjax.envs.task import num_configs, take_configs

_KEY = "key"  # in `info`: of what is drawn on the way


class RoomsNavigation(Env):
    """`RoomsTask` in one scene under Brax's contract for a single environment: batch it with `jax.vmap`.

    The observation is that of `RoomsTask.sense`, in SI units. `pipeline_state` is a `RoomsState`, the part
    that Brax's own automatic reset restores. `metrics` says which ending came about: `goal`, `collision`,
    `timeout`, each 0 or 1, and `unstable` where physics blew up, a collision too; `path_length` is that of
    the step, in m. A step keeps whatever else wrappers have put into `metrics` and `info`. With gusts or a
    camera that errs `info` holds their `key`.

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
        self.scene = scene
        self.configurations = fill(configurations)
        self.task = RoomsTask(scene.vehicle, settings, objectives=configurations.objective is not None)
        self.params = RoomsParams(make_bank([scene.map]))

    def reset(self, rng: jax.Array) -> State:
        """Starts an episode in a configuration drawn uniformly from the table."""
        rng_row, rng = jax.random.split(rng)
        row = jax.random.randint(rng_row, (), 0, num_configs(self.configurations))
        return self.reset_to(take_configs(self.configurations, row), rng)

    def reset_to(self, config: Configurations, rng: jax.Array) -> State:
        """Starts an episode in `config`, one row of a table, with a uniform random heading if it has none."""
        config = jax.tree.map(jnp.asarray, fill(config))
        state = self.task.reset(rng, config, self.params)
        # The task's reset uses the key itself and 1.
        key, of_sight = jax.random.fold_in(rng, 2), jax.random.fold_in(rng, 3)
        zero = jnp.zeros(())
        return State(
            pipeline_state=cast(Any, state),
            obs=self.task.sense(of_sight, state, self.params),
            reward=zero,
            done=zero,
            metrics=dict.fromkeys(("goal", *self.task.metrics), zero),
            info={_KEY: key} if draws_on_the_way(config) else {},
        )

    def step(self, state: State, action: jax.Array) -> State:
        """One control period under `action`. What follows an ending is undefined: reset."""
        before = cast(RoomsState, state.pipeline_state)
        # Without a key in `info` nothing is drawn: any will do.
        key, of_step, of_sight = jax.random.split(state.info.get(_KEY, jax.random.key(0)), 3)
        info = state.info | {_KEY: key} if _KEY in state.info else state.info
        after = self.task.step(of_step, before, action, self.params)
        endings = {"goal": after.success, **after.metrics}
        return state.replace(
            pipeline_state=after.state,
            obs=self.task.sense(of_sight, after.state, self.params),
            reward=after.reward,
            done=after.terminated.astype(jnp.float32),
            metrics=state.metrics | {name: came.astype(jnp.float32) for name, came in endings.items()},
            info=info,
        )

    @property
    def dt(self) -> float:
        """Seconds between actions."""
        return self.task.settings.control_period

    @property
    def observation_size(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the observation's parts."""
        camera = self.scene.vehicle.camera
        sizes = {"depth": (camera.height, camera.width), "goal": (2,)}
        objective = self.task.observation_space.get("objective")
        return sizes if objective is None else sizes | {"objective": objective.shape}

    @property
    def action_size(self) -> int:
        """15: every speed with every yaw rate."""
        return self.task.action_space.num_actions

    @property
    def backend(self) -> str:
        """The physics engine's name."""
        return "mjx"
