"""The map of a run in C MuJoCo, with the drone's depth camera by `mj_multiRay`; no JAX.

python examples/mujoco_rooms.py runs/a    (after pecjax export runs/a)
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
from velocity_controller import VelocityController


class Simulation:
    """Map, drone, camera and controller."""

    def __init__(self, scene, about):
        """Reads the MJCF file; `about` is the content of the JSON."""
        self.model = model = mujoco.MjModel.from_xml_path(str(scene))
        no_contacts = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        model.opt.disableflags &= ~int(no_contacts)  # contacts tell of collisions
        for_show = (model.geom_contype == 0) & (model.geom_conaffinity == 0)
        model.geom_matid[for_show], model.geom_rgba[for_show, 3] = -1, 0  # rays pass what is transparent
        self.data, self.drone = mujoco.MjData(model), model.body("drone").id
        self.controller = VelocityController(about)
        self.steps = round(about["control"]["period_s"] / model.opt.timestep)
        camera = about["camera"]
        self.shape, self.camera = (camera["height"], camera["width"]), np.array(camera["position_m"])
        row, column = np.indices(self.shape) + 0.5
        focal = camera["height"] / 2 / np.tan(camera["vertical_fov_rad"] / 2)  # in pixels, as are these
        right, up = column - camera["width"] / 2, camera["height"] / 2 - row
        rays = np.stack([right / focal, up / focal, -np.ones(self.shape)], axis=-1)  # to a plane 1 m ahead
        self.rays = rays.reshape(-1, 3) @ np.transpose(camera["rotation"])  # in the drone's frame

    def place(self, position, heading):
        """Puts the drone at (x, y, z) m, level and at rest, looking along a heading (rad)."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = [*position, np.cos(heading / 2), 0, 0, np.sin(heading / 2)]
        mujoco.mj_fwdPosition(self.model, self.data)

    def depth(self):
        """Planar depth (height, width) m, inf where nothing is seen."""
        rotation = self.data.xmat[self.drone].reshape(3, 3)
        eye, rays = self.data.qpos[:3] + rotation @ self.camera, self.rays @ rotation.T
        hit, depth = np.empty(len(rays), np.int32), np.empty(len(rays))
        options = (None, 1, self.drone, hit, depth, None, len(rays), mujoco.mjMAXVAL)
        mujoco.mj_multiRay(self.model, self.data, eye, rays.ravel(), *options)
        return np.where(hit < 0, np.inf, depth).reshape(self.shape)

    def step(self, speed, yaw_rate):
        """Holds a command for one control period; returns whether the drone touched a wall."""
        data, touched = self.data, False
        for _ in range(self.steps):
            state = data.xmat[self.drone].reshape(3, 3), data.qpos[2], data.qvel[:3], data.qvel[3:]
            data.ctrl[:] = self.controller.controls(*state, speed, yaw_rate)
            mujoco.mj_step(self.model, data)
            mujoco.mj_fwdPosition(self.model, data)  # contacts are those of where it is now
            touched |= data.ncon > 0
        return touched


def main(folder):
    """Prints what the drone sees from the first start, in letters from near to far, and returns it."""
    about = json.loads((Path(folder) / "policy.json").read_text())
    simulation = Simulation(f"{folder}/scene.xml", about)
    start = np.loadtxt(f"{folder}/coordinates.csv", delimiter=",", ndmin=2)[0, :2]
    simulation.place([*start, about["control"]["flight_height_m"]], heading=0.0)
    depth = simulation.depth()
    for row in np.clip(depth / about["camera"]["far_m"] * 9, 0, 9).astype(int):
        print("".join("@%#*+=-:. "[number] for number in row))
    return depth


if __name__ == "__main__":
    main(sys.argv[1])
