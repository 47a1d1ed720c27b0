"""The view from above: all flights of a map, with what one of the drones sees."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.quiver import Quiver

from pecjax.envs.rooms.rotations import heading
from pecjax.plotting.maps import floor_plan
from pecjax.plotting.style import FAILURES, PATH, STYLE, TIMEOUT
from pecjax.viewing.recording import Flight, Recording

DPI = 100
WIDTH, HEIGHT = 9.0, 5.6  # inches
COLORS = {"goal": PATH, "collision": FAILURES, "timeout": TIMEOUT, "other": "0.5"}


def top_frames(recording: Recording, follow: Flight) -> Iterator[np.ndarray]:
    """Frames (H, W, 3) uint8, one a control step until the flight that is followed has ended."""
    with matplotlib.rc_context(STYLE):
        yield from _frames(recording, follow)


def _frames(recording: Recording, follow: Flight) -> Iterator[np.ndarray]:
    flights = [flight for flight in recording.flights if flight.map_id == follow.map_id]
    figure = Figure((WIDTH, HEIGHT), dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    above, seen = figure.subplots(1, 2, width_ratios=[5.4, 3.6])
    rules, vehicle = recording.task.settings, recording.task.vehicle
    floor_plan(above, recording.maps[follow.map_id], vehicle.radius, rules)
    above.add_patch(
        Circle(tuple(follow.goal.tolist()), rules.goal_radius, fill=False, color=COLORS[follow.ending])
    )
    trails = [
        above.plot([], [], color=COLORS[flight.ending], linewidth=2 if flight is follow else 0.8)[0]
        for flight in flights
    ]
    drones = _arrows(above, flights)
    image = seen.imshow(follow.depth[0], cmap="gray_r", vmin=0, vmax=vehicle.camera.far)
    figure.colorbar(image, ax=seen, label="Depth (m)", shrink=0.6)
    seen.set(title="What the drone with the bold trail sees", xticks=[], yticks=[])
    for step in range(len(follow.poses)):
        now = [flight.poses[: step + 1] for flight in flights]
        for trail, poses in zip(trails, now, strict=True):
            trail.set_data(*poses[:, :2].T)
        last = np.stack([poses[-1] for poses in now])
        turned = np.asarray(jax.vmap(heading)(jnp.asarray(last[:, 3:])))
        drones.set_offsets(last[:, :2])
        drones.set_UVC(np.cos(turned), np.sin(turned))
        image.set_data(follow.depth[step])
        above.set_title(f"{recording.title}: {step * rules.control_period:.1f} s", loc="left")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _arrows(axes: matplotlib.axes.Axes, flights: list[Flight]) -> Quiver:
    """An arrow for each drone, in the colour of its ending."""
    starts = np.stack([flight.poses[0, :2] for flight in flights])
    colors = [COLORS[flight.ending] for flight in flights]
    ahead = np.ones(len(flights)), np.zeros(len(flights))
    return axes.quiver(
        *starts.T, *ahead, color=colors, angles="xy", scale=1.6, scale_units="xy", pivot="mid", width=0.012,
        headwidth=4, headlength=4, headaxislength=4, zorder=5,
    )  # fmt: skip
