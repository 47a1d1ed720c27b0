"""The description beside an exported policy: all that is needed to run it without pecjax."""

from __future__ import annotations

import dataclasses
import importlib.metadata
from typing import Any

import jax.numpy as jnp
import numpy as np

from pecjax.agents.distributions import MIN_SCALE
from pecjax.envs.rooms.config import OBJECTIVES
from pecjax.envs.rooms.sensing import DISTANCE_SCALE
from pecjax.envs.rooms.task import RoomsTask
from pecjax.envs.rooms.vehicle import Camera, Vehicle
from pecjax.envs.spaces import Box, Discrete
from pecjax.export.policy import ACTION, MEMORY, MEMORY_AFTER, Policy
from pecjax.training.kinds import run_label
from pecjax.training.load import Trained
from pecjax.training.run_directory import RunDirectory

_MEANING = {
    "depth": "planar depth of each pixel in m, clipped to the camera's near and far, / depth_divisor_m; "
    "row 0 is the top, column 0 the left",
    "goal": "level distance to the goal in m / distance_divisor_m, sine and cosine of its bearing: the angle "
    "from the drone's heading to the goal, seen from above, positive to the left",
    "objective": f"1 for the episode's objective, 0 for the others: {', '.join(OBJECTIVES)}",
}
_MEMORY = f"zeros at an episode's first step, then what the step before gave as {MEMORY_AFTER}"
_OUTPUTS = {
    "logits": "logits of the actions; softmax makes probabilities of them",
    "q_values": "discounted return expected of each action, in units of the learner's scaled reward",
    "parameters": f"means of normal distributions, then values x whose softplus(x) + {MIN_SCALE:g} are their "
    "standard deviations; the action is low + (high - low) (tanh(drawn) + 1) / 2",
}


def describe(directory: RunDirectory, trained: Trained, policy: Policy) -> dict[str, Any]:
    """What the JSON says of the policy of a run; docs/export.md explains it field by field."""
    settings, facts, task = directory.settings(), directory.facts(), trained.run.task
    is_rooms = isinstance(task, RoomsTask)
    content = {
        "run": {
            "label": run_label(settings),
            "preset": settings.preset,
            "checkpoint": trained.iteration,
            "git_commit": facts["git_commit"],
            "versions": facts["versions"],
        },
        "exported_with": {name: importlib.metadata.version(name) for name in ("pecjax", "jax")},
        "inputs": [
            _tensor(name, box, (_MEANING if is_rooms else {}) | {MEMORY: _MEMORY})
            for name, box in policy.inputs.items()
        ],
        "outputs": _outputs(policy),
    }
    return content | (_rooms(task) if is_rooms else {})


def _tensor(name: str, box: Box, meaning: dict[str, str]) -> dict[str, Any]:
    bounds = {"low": box.low, "high": box.high}
    return (
        {"name": name, "dtype": "float32", "shape": ["batch", *box.shape]}
        | {end: float(value) for end, value in bounds.items() if np.isfinite(value)}
        | ({"meaning": meaning[name]} if name in meaning else {})
    )


def _outputs(policy: Policy) -> list[dict[str, Any]]:
    space = policy.action_space
    if isinstance(space, Discrete):
        number = space.num_actions
        action = {"dtype": "int32", "shape": ["batch"], "low": 0, "high": number - 1}
    else:
        number = 2 * space.size
        action = _tensor(ACTION, space, {})
    values = {"name": policy.output, "dtype": "float32", "shape": ["batch", number]}
    outputs = [
        values | {"meaning": _OUTPUTS[policy.output]},
        {"name": ACTION} | action | {"meaning": "the greedy action"},
    ]
    if policy.memory is not None:
        outputs.append(_tensor(MEMORY_AFTER, policy.memory, {MEMORY_AFTER: f"the next step's {MEMORY}"}))
    return outputs


def _rooms(task: RoomsTask) -> dict[str, Any]:
    """The drone and its task, in SI units."""
    rules, vehicle = task.settings, task.vehicle
    commands = task.command(jnp.arange(task.action_space.num_actions))
    return {
        "scaling": {"depth_divisor_m": vehicle.camera.far, "distance_divisor_m": DISTANCE_SCALE},
        "actions": [
            {"speed_m_s": speed, "yaw_rate_rad_s": rate}
            for speed, rate in zip(commands.speed.tolist(), commands.yaw_rate.tolist(), strict=True)
        ],
        "control": {
            "period_s": rules.control_period,
            "rate_hz": 1 / rules.control_period,
            "physics_step_s": vehicle.timestep,
            "flight_height_m": rules.flight_height,
            "goal_radius_m": rules.goal_radius,
            "max_steps": rules.max_steps,
        },
        "camera": _camera(vehicle.camera),
        "drone": _drone(vehicle),
        "controller": dataclasses.asdict(rules.gains),
    }


def _camera(camera: Camera) -> dict[str, Any]:
    half_height = np.tan(camera.fovy / 2)
    return {
        "position_m": np.asarray(camera.position).tolist(),
        "rotation": np.asarray(camera.rotation).tolist(),
        "width": camera.width,
        "height": camera.height,
        "horizontal_fov_rad": float(2 * np.arctan(half_height * camera.width / camera.height)),
        "vertical_fov_rad": float(camera.fovy),
        "near_m": float(camera.near),
        "far_m": float(camera.far),
    }


def _drone(vehicle: Vehicle) -> dict[str, Any]:
    rotors = vehicle.rotors
    return {
        "mass_kg": float(vehicle.mass),
        "inertia_kg_m2": np.asarray(vehicle.inertia).tolist(),
        "radius_m": float(vehicle.radius),
        "gravity_m_s2": float(vehicle.gravity),
        "rotor_wrench": np.asarray(rotors.wrench).tolist(),
        "rotor_lower": np.asarray(rotors.lower).tolist(),
        "rotor_upper": np.asarray(rotors.upper).tolist(),
    }
