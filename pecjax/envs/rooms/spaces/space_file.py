"""Files of spaces: one compact file each, the same bytes for the same space."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from pecjax.envs.axes import columns_of, from_columns
from pecjax.envs.rooms.centimetres import to_centimetres, to_metres
from pecjax.envs.rooms.config import MAX_MAPS, Configurations
from pecjax.envs.rooms.maps import MAX_WALLS, MapBank
from pecjax.envs.rooms.spaces.catalogue import find_recipe, make_space
from pecjax.envs.rooms.spaces.space import SPLITS, Part, Space, arrays_of, check_held_out
from pecjax.errors import InputError
from pecjax.storage.arrays import read_plain_arrays
from pecjax.storage.files import replacing, writing

SUFFIX = ".npz"


def write_space(path: Path, space: Space) -> None:
    """Writes a space; corners of walls take two bytes each, in centimetres.

    Raises:
        InputError: the file cannot be written.
    """
    arrays = arrays_of(space)
    for name in ("maps/lower", "maps/upper"):
        if name in arrays:
            arrays[name] = to_centimetres(arrays[name], f"space {space.name}: {name}")
    about = {"name": space.name, "about": space.about, "groups": space.groups, "version": space.version}
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    save: Any = np.savez  # whose own arguments no array is named like
    # Two processes may make the same space at once.
    new = path.with_name(f".{os.getpid()}-{path.name}")
    with writing(path, "choose another place"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, new), new.open("wb") as file:
            save(file, **arrays)


def read_space(path: Path) -> Space:
    """Reads a space back, and makes sure that it is what was written.

    Raises:
        InputError: the file is missing, is no space, or holds other arrays than its checksum says.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a space's name or its file")
    arrays = read_plain_arrays(path, "make it again")
    try:
        space, version = _from_arrays(arrays)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise InputError(f"{path}: no file of a space ({error!r}); make it again") from error
    if space.version != version:
        raise InputError(f"{path}: its content is {space.version}, not {version} as it says; make it again")
    check_held_out(space)
    return space


def _from_arrays(arrays: dict[str, np.ndarray]) -> tuple[Space, str]:
    about: dict[str, Any] = json.loads(arrays["about"].tobytes())
    groups = tuple(map(str, about["groups"]))
    bank = None
    if "maps/lower" in arrays:
        lower, upper = (_metres(arrays[f"maps/{name}"]) for name in ("lower", "upper"))
        bounds = arrays["maps/bounds"]
        maps, walls = lower.shape[:2]
        if lower.shape != (maps, walls, 3) or upper.shape != lower.shape or bounds.shape != (maps, 2, 2):
            raise ValueError("maps of other shapes")
        if not (0 < maps <= MAX_MAPS and 0 < walls <= MAX_WALLS and np.isfinite(bounds).all()):
            raise ValueError("maps of no size, or of too many walls")
        bank = MapBank(lower, upper, bounds.astype(np.float32))
    maps = 1 if bank is None else len(bank.lower)
    train, held_out = (_part(arrays, split, len(groups), maps) for split in SPLITS)
    name, says = str(about["name"]), str(about["about"])
    return Space(name, says, groups, train, held_out, bank), str(about["version"])


def _part(arrays: dict[str, np.ndarray], split: str, groups: int, maps: int) -> Part:
    columns = columns_of(Configurations)
    given = {name: arrays[f"{split}/{name}"] for name in columns if f"{split}/{name}" in arrays}
    table = from_columns(Configurations, given, lambda row, column: f"{split} row {row}")
    group, lengths = (arrays[f"{split}/{name}"] for name in ("group", "shortest"))
    if group.shape != (table.size,) or lengths.shape != (table.size,):
        raise ValueError(f"{split}: tables of several lengths")
    if not (np.isin(group, range(groups)).all() and np.all(lengths >= 0) and np.all(table.map_id < maps)):
        raise ValueError(f"{split}: groups, lengths or maps that are not there")
    return Part(table, group.astype(np.int32), lengths.astype(np.float32))


def _metres(corners: np.ndarray) -> np.ndarray:
    if corners.dtype != np.int16:
        raise ValueError("corners are no whole centimetres")
    return to_metres(corners)


def space_path(name: str) -> Path:
    """The file of a space, given by name or as a file.

    That of a name is in the user's cache folder, and is made there if it is not.

    Raises:
        InputError: there is no such space, or the folder cannot be written.
    """
    if name.endswith(SUFFIX):
        return Path(name)
    recipe = find_recipe(name)
    path = Path(platformdirs.user_cache_dir("pecjax")) / "spaces" / f"{name}-{recipe.version}{SUFFIX}"
    if not path.is_file():
        write_space(path, make_space(name))
    return path
