"""An exported policy: the ONNX file and its JSON, and nothing of pecjax or JAX.

python examples/exported_policy.py runs/a/policy.onnx    (after pecjax export runs/a)
"""

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime


class ExportedPolicy:
    """From what sensors say to a velocity command; `about` is the JSON, which docs/export.md explains."""

    def __init__(self, path):
        """Loads both files, which must belong together."""
        model = Path(path).read_bytes()
        self.about = json.loads(Path(path).with_suffix(".json").read_text())
        if hashlib.sha256(model).hexdigest() != self.about["sha256"]:
            raise ValueError(f"{path} is not the file that its JSON describes; export it again")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # the network is too small to be shared
        self.session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        self.begin()

    def begin(self):
        """Forgets the last episode, where the policy has a memory of it."""
        sizes = {tensor["name"]: tensor["shape"][-1] for tensor in self.about["inputs"]}
        self.memory = np.zeros((1, sizes.get("memory", 0)), np.float32)

    def inputs(self, depth, distance, bearing):
        """What the network is given, a batch of one (see `act`)."""
        camera, scaling = self.about["camera"], self.about["scaling"]
        depth = np.clip(depth, camera["near_m"], camera["far_m"]) / scaling["depth_divisor_m"]
        goal = [distance / scaling["distance_divisor_m"], np.sin(bearing), np.cos(bearing)]
        inputs = {"depth": np.float32(depth)[None], "goal": np.float32(goal)[None]}
        return inputs | ({"memory": self.memory} if self.memory.size else {})

    def act(self, depth, distance, bearing):
        """The greedy action: speed ahead (m/s) and yaw rate (rad/s, positive to the left).

        The depth image (height, width) is planar and in m, inf where nothing is seen. The goal's distance (m)
        and its bearing off the heading (rad, positive to the left) are seen from above.
        """
        wanted = ["action", "memory_after"][: 1 + bool(self.memory.size)]
        action, *after = self.session.run(wanted, self.inputs(depth, distance, bearing))
        self.memory = after[0] if after else self.memory
        command = self.about["actions"][int(action[0])]
        return command["speed_m_s"], command["yaw_rate_rad_s"]


def heading(quaternion):
    """Where the drone looks (rad), seen from above; the quaternion is w-x-y-z."""
    w, x, y, z = quaternion
    return np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


def towards(goal, position, heading):
    """Distance (m) and bearing (rad, in [-π, π)) of a goal (x, y), seen from above."""
    offset = np.subtract(goal[:2], position[:2])
    bearing = np.arctan2(offset[1], offset[0]) - heading
    return np.hypot(*offset), (bearing + np.pi) % (2 * np.pi) - np.pi


def main(path):
    """Prints where the policy flies in the open, for a goal ahead and on either side."""
    policy = ExportedPolicy(path)
    camera = policy.about["camera"]
    print(policy.about["run"]["label"])
    for bearing in (-np.pi / 2, 0.0, np.pi / 2):
        speed, yaw_rate = policy.act(np.full((camera["height"], camera["width"]), np.inf), 3.0, bearing)
        print(f"goal 3 m away at {bearing:+.2f} rad: {speed:g} m/s, turning at {yaw_rate:+.2f} rad/s")


if __name__ == "__main__":
    main(sys.argv[1])
