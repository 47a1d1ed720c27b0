"""Weather: winds up to beyond what can be flown, and which flights they forbid."""

from __future__ import annotations

from typing import Any

import numpy as np

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.rules import NavigationSettings
from pecjax.envs.rooms.task import SPEEDS
from pecjax.envs.rooms.vehicle import Vehicle

STRONGEST = 12.0  # m/s of wind
GROUPS = ("calm", "windy", "storm", "beyond")
_FROM = (4.0, 8.0)  # m/s, where windy begins, and storm
_BACKWARD, _UPWIND = -0.3, 1.5  # m/s over ground against the wind, m against the wind


def draw_weather(draw: np.random.Generator, number: int) -> dict[str, Any]:
    """Axes of so many configurations: wind, gust, payload and visibility, each as often as any other."""
    speed, towards = draw.uniform(0, STRONGEST, number), draw.uniform(-np.pi, np.pi, number)
    wind = np.stack([speed * np.cos(towards), speed * np.sin(towards), np.zeros(number)], axis=-1)
    return {
        "wind": wind.round(2),
        "gust": draw.uniform(0, 1, number).round(2),
        "payload": draw.uniform(0, 0.5, number).round(2),
        "visibility": np.exp(draw.uniform(np.log(1), np.log(20), number)).round(2),
    }


def upwind_speed(vehicle: Vehicle, settings: NavigationSettings, wind: np.ndarray) -> np.ndarray:
    """The steady speed (N,) m/s over ground of a drone that flies straight into a wind (N,) m/s.

    It is asked for the highest speed u. The controller's force m k (u - v) is then the drag
    c (w + v)², where v is the speed over ground; what the drone carries does not matter. Below the
    tilt limit, which it never nears here.
    """
    stiffness, drag = vehicle.mass * settings.gains.velocity, max(settings.drag[:2])
    past = (np.sqrt(stiffness**2 + 4 * drag * stiffness * (max(SPEEDS) + wind)) - stiffness) / (2 * drag)
    return past - wind


def groups_of(table: Configurations, vehicle: Vehicle, settings: NavigationSettings) -> np.ndarray:
    """The place (N,) int32 in `GROUPS` of each configuration.

    "Beyond" is what cannot be flown, by a margin: the wind drives the drone back however it flies, and
    its goal lies against the wind. The others are by the speed of their wind.
    """
    wind = np.asarray(table.wind, np.float64)[:, :2]
    speed = np.linalg.norm(wind, axis=1)
    way = np.asarray(table.goal, np.float64) - np.asarray(table.start, np.float64)
    against = -np.sum(way * wind, axis=1) / np.maximum(speed, 1e-9)
    lost = (upwind_speed(vehicle, settings, speed) < _BACKWARD) & (against > _UPWIND)
    return np.where(lost, len(GROUPS) - 1, np.searchsorted(_FROM, speed, side="right")).astype(np.int32)
