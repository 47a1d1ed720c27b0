"""The controller that pecjax trains with, in NumPy: a velocity command becomes rotor controls.

python examples/velocity_controller.py runs/a    (after pecjax export runs/a)

Geometric control after Lee et al. (2010), once per physics step, with the numbers in the export's JSON.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np


class VelocityController:
    """Holds a speed ahead (m/s), a yaw rate (rad/s) and the flight height."""

    def __init__(self, about):
        """Takes the content of the JSON."""
        self.gains, drone = about["controller"], about["drone"]
        self.height = about["control"]["flight_height_m"]
        self.mass, self.gravity = drone["mass_kg"], drone["gravity_m_s2"]
        self.inertia = np.array(drone["inertia_kg_m2"])
        self.inverse = np.linalg.pinv(drone["rotor_wrench"])
        self.lower, self.upper = np.array(drone["rotor_lower"]), np.array(drone["rotor_upper"])

    def controls(self, rotation, height, velocity, rates, speed, yaw_rate):
        """Rotor controls (U,).

        Args:
            rotation: (3, 3), columns are the drone's axes in the world.
            height, velocity: m, and (3,) m/s in the world.
            rates: (3,) rad/s in the drone's frame.
        """
        gains, weight = self.gains, np.array([0, 0, self.gravity])
        force = self.mass * (self.acceleration(rotation, height, velocity, speed, yaw_rate) + weight)
        tilt_x, tilt_y, _ = force @ rotation / np.sqrt(force @ force)  # where the thrust should point
        lag = yaw_rate * rotation[2] - rates
        turn = gains["body_rate"] * lag + gains["attitude"] * np.array([-tilt_y, tilt_x, 0])
        turn[2] = gains["yaw_rate"] * lag[2]
        torque = self.inertia * turn + np.cross(rates, self.inertia * rates)
        lift = self.inverse[:, :3] @ [force @ rotation[:, 2], torque[0], torque[1]]
        lift = np.clip(lift, self.lower, self.upper)
        yaw = self.inverse[:, 3] * torque[2]  # gets what the others leave
        room = np.where(yaw > 0, self.upper - lift, lift - self.lower)
        return lift + min(np.min(room / np.maximum(np.abs(yaw), 1e-6)), 1.0) * yaw

    def acceleration(self, rotation, height, velocity, speed, yaw_rate):
        """The acceleration (3,) m/s² in the world that brings the velocity to the command's."""
        gains, ahead = self.gains, rotation[:2, 0] / np.hypot(*rotation[:2, 0])
        left = np.array([-ahead[1], ahead[0]])
        forward, side = velocity[:2] @ ahead, velocity[:2] @ left
        turning = yaw_rate if gains["turn_feed_forward"] else 0.0
        level = (gains["velocity"] * (speed - forward) - turning * side) * ahead
        level = level + (turning * forward - gains["velocity"] * side) * left
        limit = self.gravity * np.tan(gains["max_tilt"])
        level = level * min(1.0, limit / (np.sqrt(level @ level) + 1e-6))
        climb = gains["climb"] * (gains["height"] * (self.height - height) - velocity[2])
        return np.array([*level, climb])


def main(folder, seconds=3.0):
    """Flies a turn at 1 m/s in C MuJoCo; prints and returns speed and height at its end."""
    controller = VelocityController(json.loads((Path(folder) / "policy.json").read_text()))
    model = mujoco.MjModel.from_xml_path(f"{folder}/scene.xml")
    data = mujoco.MjData(model)
    data.qpos[2] = controller.height
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step1(model, data)
        state = data.body("drone").xmat.reshape(3, 3), data.qpos[2], data.qvel[:3], data.qvel[3:]
        data.ctrl[:] = controller.controls(*state, speed=1.0, yaw_rate=np.pi / 4)
        mujoco.mj_step2(model, data)
    print(f"after {seconds:g} s: {np.hypot(*data.qvel[:2]):.3f} m/s at {data.qpos[2]:.3f} m")
    return np.hypot(*data.qvel[:2]), data.qpos[2]


if __name__ == "__main__":
    main(sys.argv[1])
