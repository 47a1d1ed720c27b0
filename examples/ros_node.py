"""A node of ROS size around an exported policy: depth image, odometry and goal in, velocity command out.

python examples/ros_node.py runs/a/policy.onnx    (after pecjax export runs/a)

Messages are dictionaries with the fields of sensor_msgs/Image (planar depth, 32FC1 or 16UC1, of a camera
with the JSON's field of view), nav_msgs/Odometry, geometry_msgs/PoseStamped (in odometry's frame) and
Twist. In ROS each callback is a subscription, and a timer calls `on_timer` every `period_s` of the JSON.
"""

import sys

import numpy as np
from exported_policy import ExportedPolicy, heading, towards


class PolicyNode:
    """Flies to the goal; stands still without one, at it, and when sensors have been silent for 3 periods."""

    def __init__(self, path):
        """Loads the policy; nothing is known yet."""
        self.policy, self.goal, self.latest = ExportedPolicy(path), None, {}

    def on_depth(self, image):
        """Keeps the pixels nearest to the centres of the network's."""
        camera = self.policy.about["camera"]
        kind, unit = {"32FC1": ("f4", 1.0), "16UC1": ("u2", 0.001)}[image["encoding"]]
        dtype = np.dtype(kind).newbyteorder(">" if image["is_bigendian"] else "<")
        lines = np.frombuffer(image["data"], np.uint8).reshape(image["height"], image["step"])
        whole = np.ascontiguousarray(lines[:, : image["width"] * dtype.itemsize]).view(dtype)
        sides = ("height", "width")
        row, column = ((2 * np.arange(camera[n]) + 1) * image[n] // (2 * camera[n]) for n in sides)
        depth = whole[np.ix_(row, column)] * unit
        depth[np.isnan(depth) | (depth == 0)] = np.inf  # without a reading, as in training
        self.keep("depth", image, depth)

    def on_odometry(self, odometry):
        """Keeps position (x, y, z) m and attitude w-x-y-z."""
        pose = odometry["pose"]["pose"]
        position = [pose["position"][axis] for axis in "xyz"]
        self.keep("pose", odometry, (position, [pose["orientation"][axis] for axis in "wxyz"]))

    def on_goal(self, goal):
        """Keeps where to fly, until another goal comes; a policy with a memory begins anew."""
        self.policy.begin()
        self.goal = [goal["pose"]["position"][axis] for axis in "xy"]

    def keep(self, name, message, value):
        """Keeps a value with the time (s) of its message."""
        stamp = message["header"]["stamp"]
        self.latest[name] = stamp["sec"] + 1e-9 * stamp["nanosec"], value

    def on_timer(self, now):
        """The Twist to fly, along the heading and level; `now` in s, by the clock of the stamps."""
        control, speed, yaw_rate, climb = self.policy.about["control"], 0.0, 0.0, 0.0
        known = {n: value for n, (at, value) in self.latest.items() if now - at < 3 * control["period_s"]}
        if "pose" in known:
            position, quaternion = known["pose"]
            climb = self.policy.about["controller"]["height"] * (control["flight_height_m"] - position[2])
            if self.goal is not None and "depth" in known:
                distance, bearing = towards(self.goal, position, heading(quaternion))
                if distance >= control["goal_radius_m"]:
                    speed, yaw_rate = self.policy.act(known["depth"], distance, bearing)
        return {"linear": {"x": speed, "y": 0.0, "z": climb}, "angular": {"x": 0.0, "y": 0.0, "z": yaw_rate}}


def main(path, depth=5.0):
    """Prints and returns the command before a wall at `depth` m, with a goal 3 m ahead."""
    node, at = PolicyNode(path), {"header": {"stamp": {"sec": 0, "nanosec": 0}}}
    image = {"height": 480, "width": 640, "step": 2560, "encoding": "32FC1", "is_bigendian": 0}
    node.on_depth(at | image | {"data": np.full((480, 640), depth, "<f4").tobytes()})
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 1.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    node.on_odometry(at | {"pose": {"pose": pose}})
    node.on_goal(at | {"pose": {"position": {"x": 3.0, "y": 0.0, "z": 0.0}}})
    print(twist := node.on_timer(now=0.1))
    return twist


if __name__ == "__main__":
    main(sys.argv[1])
