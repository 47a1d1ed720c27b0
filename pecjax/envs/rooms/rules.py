"""Rules: rewards and endings of the task, and the numbers of its drone that no map says."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pecjax.envs.rooms.controller import ControllerGains
from pecjax.errors import InputError
from pecjax.ranges import ABOVE_0, NOT_NEGATIVE, POSITIVE, check_ranges

MAX_PHYSICS_STEPS = 1000  # in one control period
_RANGES = {"goal_radius": POSITIVE, "max_steps": (1, math.inf), "gust_time": POSITIVE, "hold_time": POSITIVE}
_RANGES_OF_GAINS = dict.fromkeys(
    ("height", "climb", "velocity", "attitude", "body_rate", "yaw_rate"), NOT_NEGATIVE
) | {"max_tilt": (ABOVE_0, 1.5)}  # rad; at π/2 it could not hold its height


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
        hold_time: s for which a goal must be held, where that is the objective.
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
    hold_time: float = 2.0
    gains: ControllerGains = ControllerGains()


def physics_steps(settings: NavigationSettings, timestep: float) -> int:
    """How many physics steps of `timestep` s an action lasts; the other numbers are checked as well.

    Raises:
        InputError: a control period that is no multiple of the physics step, negative drag, or a number
            out of its range.
    """
    ratio = settings.control_period / max(timestep, 1e-9)
    steps = round(ratio)
    if not 1 <= steps <= MAX_PHYSICS_STEPS or abs(ratio - steps) > 1e-6:
        raise InputError(
            f"control period {settings.control_period} s is not a multiple of the scene's timestep "
            f"{timestep} s, or more than {MAX_PHYSICS_STEPS} times it; change either"
        )
    if len(settings.drag) != 3 or min(settings.drag) < 0:
        raise InputError(f"drag is {settings.drag}; give three numbers that are not negative")
    check_ranges(settings, _RANGES)
    check_ranges(settings.gains, _RANGES_OF_GAINS)
    return steps
