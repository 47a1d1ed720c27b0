"""Solids: MuJoCo's convex shapes as the corners of polyhedra that hold them."""

from __future__ import annotations

import functools

import mujoco
import numpy as np

from pecjax.errors import InputError

_MOST_CORNERS = 2048  # of a polyhedron


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom can touch anything."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def is_wall(model: mujoco.MjModel, geom: int, drone: int) -> bool:
    """Whether a geom can be hit, and is not the drone's."""
    return model.geom_bodyid[geom] != drone and collides(model, geom)


def is_along_axes(axes: np.ndarray) -> bool:
    """Whether axes, the columns of (3, 3), are the map's but for right angles."""
    return np.allclose(np.abs(axes).max(axis=0), 1.0, atol=1e-6)


def corners_of(model: mujoco.MjModel, geom: int, slack: float) -> tuple[np.ndarray, float] | None:
    """A polyhedron that holds a geom; None for a plane or a height field, which is no convex solid.

    A mesh is its convex hull, as in MuJoCo's contacts.

    Args:
        slack: m, how far the polyhedron of a round geom may reach beyond it.

    Returns:
        (V, 3) m, points whose convex hull it is, in the geom's frame; and m, how far it reaches beyond
        the geom at most.

    Raises:
        InputError: the geom is too large for so little slack; without its name.
    """
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return size * _CUBE, 0.0
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64), 0.0
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        ring, beyond = _ring(slack / size[0])
        ends = [np.column_stack([size[0] * ring, np.full(len(ring), z)]) for z in (-size[1], size[1])]
        return np.concatenate(ends), beyond * size[0]
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
        ball, beyond = _ball(slack / size[0])
        half = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        return np.concatenate([size[0] * ball + (0, 0, z) for z in (-half, half)]), beyond * size[0]
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        ball, beyond = _ball(slack / size.max())
        return size * ball, beyond * size.max()
    return None


_CUBE = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def _ring(slack: float) -> tuple[np.ndarray, float]:
    """Corners (V, 2) of a regular polygon around the unit circle, and how far they reach beyond it."""
    number = max(8, int(np.ceil(np.pi / np.arccos(1 / (1 + slack)))))
    if number > _MOST_CORNERS:
        raise InputError("it is too large for that")
    reach = 1 / np.cos(np.pi / number)
    angles = 2 * np.pi / number * np.arange(number)
    return reach * np.column_stack([np.cos(angles), np.sin(angles)]), reach - 1


def _ball(slack: float) -> tuple[np.ndarray, float]:
    """Corners (V, 3) of a polyhedron around the unit ball, and how far they reach beyond it."""
    number = 64
    while (scale := _scale(number)) - 1 > slack:
        number *= 2
        if number > _MOST_CORNERS:
            raise InputError("it is too large for that")
    return scale * _spiral(number), scale - 1


@functools.cache
def _scale(number: int) -> float:
    """What points of the unit sphere are multiplied by for their hull to hold the ball."""
    from scipy.spatial import ConvexHull  # takes long to import

    return float(-1 / ConvexHull(_spiral(number)).equations[:, 3].max())


def _spiral(number: int) -> np.ndarray:
    """Points (N, 3) spread evenly over the unit sphere (Fibonacci's lattice)."""
    order = np.arange(number) + 0.5
    z, turn = 1 - 2 * order / number, np.pi * (1 + 5**0.5) * order
    ring = np.sqrt(1 - z**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
