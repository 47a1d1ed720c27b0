"""Assets in files of their own: left out where they are only for show, so that nobody opens them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco

from pecjax.errors import InputError

MAX_MESH_BYTES = 2**22  # of a file


def leave_out_assets(
    spec: mujoco.MjSpec, place_of: Callable[[str, Any], str], but_solid_meshes: bool = False
) -> None:
    """Takes meshes, height fields, textures and skins that have files out of a map, in place.

    A geom that shows one and does not collide goes with it. A map is kept as one file, and what is
    neither hit nor seen by the drone's camera changes nothing.

    Args:
        place_of: (kind, element) -> where it stands, for messages.
        but_solid_meshes: keeps the meshes of geoms that collide.

    Raises:
        InputError: a geom that collides, or that the drone's mass depends on, or a site needs a file; or
            one that is kept is too large.
    """
    files: dict[str, dict[str, str]] = {"mesh": {}, "hfield": {}}
    for kind, assets in (("mesh", spec.meshes), ("hfield", spec.hfields)):
        files[kind] = {asset.name or _stem(asset.file): asset.file for asset in assets if asset.file}
    kept = set()
    for geom in list(spec.geoms):
        file = files["mesh"].get(geom.meshname) or files["hfield"].get(geom.hfieldname)
        if not file:
            continue
        what = f"{place_of('geom', geom)}: geom '{geom.name}'" if geom.name else place_of("geom", geom)
        if geom.contype or geom.conaffinity:
            if but_solid_meshes and geom.meshname in files["mesh"]:
                _check_size(what, Path(spec.modelfiledir, spec.compiler.meshdir, file))
                kept.add(geom.meshname)
                continue
            raise InputError(
                f"{what} collides and needs the file '{file}', which is not read; build what can be hit of "
                "boxes along the axes, or give --task.approximate 0.05 to have boxes in a mesh's place"
            )
        if _has_mass(spec, geom):
            raise InputError(
                f"{what} needs the file '{file}', which is not read, and the drone's mass depends on it; "
                'give the geom mass="0" or the drone an <inertial>'
            )
        spec.delete(geom)
    for site in spec.sites:
        if site.meshname in files["mesh"]:
            raise InputError(
                f"{place_of('site', site)}: site '{site.name}' needs the file "
                f"'{files['mesh'][site.meshname]}', which is not read; give it another shape"
            )
    pictures = {texture.name or _stem(texture.file) for texture in spec.textures if _has_file(texture)}
    for material in spec.materials:
        material.textures = ["" if name in pictures else name for name in material.textures]
    for light in spec.lights:
        light.texture = "" if light.texture in pictures else light.texture
    for asset in (*spec.meshes, *spec.hfields, *spec.textures, *spec.skins):
        if _has_file(asset) and (asset.name or _stem(asset.file)) not in kept:
            spec.delete(asset)


def _check_size(what: str, file: Path) -> None:
    if file.is_file() and file.stat().st_size > MAX_MESH_BYTES:
        raise InputError(
            f"{what}: '{file}' is larger than {MAX_MESH_BYTES:,} bytes; a wall needs fewer faces"
        )


def _stem(file: str) -> str:
    """The name that MuJoCo gives to an asset without one."""
    return file.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]


def _has_file(asset: Any) -> bool:
    return bool(asset.file) or any(getattr(asset, "cubefiles", ()))


def _has_mass(spec: mujoco.MjSpec, geom: Any) -> bool:
    if spec.compiler.settotalmass > 0:
        return True
    if geom.parent.name != "drone" or geom.mass == 0 or (math.isnan(geom.mass) and geom.density == 0):
        return False
    given = geom.parent.explicitinertial
    return not given or spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
