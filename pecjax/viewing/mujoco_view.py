"""The view of MuJoCo's renderer: a drone followed through its map, with what it sees."""

from __future__ import annotations

from collections.abc import Iterator

import jax.numpy as jnp
import mujoco
import numpy as np

from pecjax.envs.rooms.rotations import heading
from pecjax.errors import InputError
from pecjax.viewing.recording import Flight, Recording, drawn_walls

WIDTH, HEIGHT = 800, 600  # pixels
INSET = 208  # pixels, the width of the depth image
DISTANCE, ELEVATION = 3.2, -26.0  # m and degrees, of the camera from the drone
TURNING = 0.15  # share of a turn that the camera follows in each frame
_MOST_GEOMS = 5000
_RGBA = {
    "goal": (0.0, 0.62, 0.45, 1),
    "collision": (0.84, 0.37, 0.0, 1),
    "timeout": (0.9, 0.62, 0.0, 1),
    "other": (0.48, 0.48, 0.48, 1),
}


def mujoco_frames(recording: Recording, follow: Flight) -> Iterator[np.ndarray]:
    """Frames (H, W, 3) uint8, one a control step, of all flights in the map of one that is followed.

    Raises:
        InputError: there is no OpenGL.
    """
    flights = [flight for flight in recording.flights if flight.map_id == follow.map_id]
    model = _scene(recording, follow, flights)
    try:
        renderer = mujoco.Renderer(model, HEIGHT, WIDTH, max_geom=_MOST_GEOMS)
    except Exception as error:  # each of the ways to OpenGL fails in its own way
        raise InputError(
            "MuJoCo cannot draw here (no OpenGL); set MUJOCO_GL=egl or osmesa where one of them is "
            "installed, or leave out --renderer"
        ) from error
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    camera.distance, camera.elevation = DISTANCE, ELEVATION
    camera.azimuth = _azimuth(follow.poses[0])
    with renderer:
        for step, pose in enumerate(follow.poses):
            for number, flight in enumerate(flights):
                there = flight.poses[min(step, len(flight.poses) - 1)]
                data.mocap_pos[number], data.mocap_quat[number] = there[:3], there[3:]
            mujoco.mj_forward(model, data)
            camera.lookat[:] = pose[:3]
            turn = (_azimuth(pose) - camera.azimuth + 180) % 360 - 180
            camera.azimuth += TURNING * turn
            renderer.update_scene(data, camera)
            _add_trail(renderer.scene, follow, step)
            yield _with_inset(renderer.render(), follow.depth[step], recording.task.vehicle.camera.far)


def _azimuth(pose: np.ndarray) -> float:
    return float(np.degrees(heading(jnp.asarray(pose[3:]))))


def _scene(recording: Recording, follow: Flight, flights: list[Flight]) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
    spec.visual.headlight.ambient[:] = 0.35
    spec.visual.headlight.diffuse[:] = 0.35
    spec.visual.map.znear = 0.005
    sky, checker = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, mujoco.mjtBuiltin.mjBUILTIN_CHECKER
    textures = mujoco.mjtTexture
    spec.add_texture(
        name="sky", type=textures.mjTEXTURE_SKYBOX, builtin=sky, rgb1=[0.75, 0.85, 0.95], rgb2=[1, 1, 1],
        width=256, height=256,
    )  # fmt: skip
    spec.add_texture(
        name="floor", type=textures.mjTEXTURE_2D, builtin=checker, rgb1=[0.86, 0.87, 0.86],
        rgb2=[0.8, 0.82, 0.81], width=256, height=256,
    )  # fmt: skip
    floor = spec.add_material(name="floor", texrepeat=[1, 1], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    world = spec.worldbody
    about = recording.maps[follow.map_id]
    center, half = about.bounds.mean(axis=0), np.ptp(about.bounds, axis=0) / 2
    world.add_light(pos=[*center, 12], dir=[0.3, 0.4, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    world.add_geom(type=plane, pos=[*center, 0], size=[*half, 0.1], material="floor")
    box = mujoco.mjtGeom.mjGEOM_BOX
    for lower, upper in zip(*drawn_walls(about), strict=True):
        middle, size = (lower + upper) / 2, np.maximum(upper - lower, 1e-3) / 2
        world.add_geom(type=box, pos=middle, size=size, rgba=[0.73, 0.77, 0.8, 1])
    radius, color = recording.task.settings.goal_radius, [*_RGBA["goal"][:3], 0.4]
    disc = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [radius, 0.01, 0], "rgba": color}
    world.add_geom(pos=[*follow.goal, 0.01], **disc)
    for flight in flights:
        _add_drone(world.add_body(mocap=True), recording.task.vehicle.radius, _RGBA[flight.ending])
    return spec.compile()


def _add_drone(body: mujoco.MjsBody, radius: float, rgba: tuple[float, ...]) -> None:
    kinds, dark = mujoco.mjtGeom, [0.15, 0.2, 0.25, 1]
    body.add_geom(type=kinds.mjGEOM_ELLIPSOID, size=[0.43 * radius, 0.32 * radius, 0.2 * radius], rgba=rgba)
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        end = [0.6 * radius * x, 0.6 * radius * y, 0.1 * radius]
        arm = {"fromto": [0, 0, 0, *end], "size": [0.04 * radius, 0, 0], "rgba": dark}
        body.add_geom(type=kinds.mjGEOM_CAPSULE, **arm)
        rotor = {"pos": end, "size": [0.34 * radius, 0.02 * radius, 0], "rgba": [0.33, 0.38, 0.44, 0.6]}
        body.add_geom(type=kinds.mjGEOM_CYLINDER, **rotor)


def _add_trail(scene: mujoco.MjvScene, flight: Flight, step: int) -> None:
    """Draws the way of a flight so far."""
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    for before, after in zip(flight.poses[:step], flight.poses[1 : step + 1], strict=True):
        if scene.ngeom == scene.maxgeom:
            return
        geom = scene.geoms[scene.ngeom]
        rgba = np.array(_RGBA[flight.ending], np.float32)
        mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
        mujoco.mjv_connector(geom, capsule, 0.015, before[:3].astype(float), after[:3].astype(float))
        scene.ngeom += 1


def _with_inset(frame: np.ndarray, depth: np.ndarray, far: float) -> np.ndarray:
    """The frame with the depth image in its upper right corner; what is near is bright."""
    tallest = frame.shape[0] - 20
    apart = max(-(-depth.shape[1] // INSET), -(-depth.shape[0] // tallest))
    depth = depth[::apart, ::apart]  # of an image larger than the corner
    factor = min(INSET // depth.shape[1], tallest // depth.shape[0])
    image = np.kron(255 * (1 - depth / far), np.ones((factor, factor))).astype(np.uint8)
    height, width = image.shape
    frame = frame.copy()
    frame[8 : 12 + height, -12 - width : -8] = 255
    frame[10 : 10 + height, -10 - width : -10] = image[..., None]
    return frame
