"""Array files: a pytree of arrays as one .npz file, whole or not there, and read without pickle.

NumPy's format keeps a checksum of every array; `docs/reliability.md` has what writing one costs.
"""

from __future__ import annotations

import json
import os
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.errors import InputError
from pecjax.experiments.plain_files import differences
from pecjax.experiments.processes import is_lead, on_host


class BrokenFileError(Exception):
    """A file is not what was written."""


_ABOUT = "about"
# What Python's and NumPy's readers raise over files with changed bytes.
_UNREADABLE = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    MemoryError,
    RuntimeError,
    SyntaxError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def write_arrays(path: Path, tree: Any, about: dict[str, Any] | None = None) -> None:
    """Writes every leaf under its place in the tree; the file is put in place of another at once.

    Where several processes share a training all of them call it, and the lead writes.

    Args:
        about: what the arrays belong to, as JSON.
    """
    named, _ = jax.tree_util.tree_flatten_with_path(tree)
    arrays = {jax.tree_util.keystr(place): on_host(_plain(leaf)) for place, leaf in named}
    if not is_lead():
        return
    if about is not None:
        arrays[_ABOUT] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    path.parent.mkdir(exist_ok=True)
    new = path.with_name(f".{path.name}")
    save: Any = np.savez  # whose own arguments no place in a tree is named like
    try:
        with new.open("wb") as file:
            save(file, **arrays)
        os.replace(new, path)
    except OSError:
        new.unlink(missing_ok=True)  # on a full disk it would take the room that is wanted
        raise


def read_arrays(path: Path, like: Any, about: dict[str, Any] | None = None) -> Any:
    """Reads a tree back, its leaves placed on the devices where those of `like` have a sharding.

    Args:
        like: a tree of the same structure, of arrays or their shapes.
        about: what the arrays must belong to, if that matters.

    Raises:
        BrokenFileError: the file is torn or changed.
        InputError: it is whole, but belongs to something else.
    """
    named, structure = jax.tree_util.tree_flatten_with_path(like)
    wanted = {jax.tree_util.keystr(place): leaf for place, leaf in named}
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays: dict[str, Any] = {name: file[name] for name in file.files}
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("a part is no array")
        written = json.loads(arrays.pop(_ABOUT).tobytes()) if _ABOUT in arrays else {}
    except _UNREADABLE as error:
        raise BrokenFileError(f"{path}: torn or changed ({error})") from error
    if about is not None:
        differing = list(differences(written, json.loads(json.dumps(about))))
        if differing:
            raise InputError(f"{path}: belongs to a run that differs in {', '.join(differing)}")
    differing = sorted(set(arrays) ^ set(wanted)) or [
        name for name, leaf in wanted.items() if not _alike(arrays[name], _plain_shape(leaf))
    ]
    if differing:
        more = f" and {len(differing) - 3} more" if len(differing) > 3 else ""
        raise InputError(
            f"{path}: was written with other settings or by another version; it differs in "
            f"{', '.join(differing[:3])}{more}"
        )
    return jax.tree.unflatten(structure, [_placed(arrays[name], leaf) for name, leaf in wanted.items()])


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _plain(leaf: Any) -> Any:
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _plain_shape(leaf: Any) -> Any:
    return jax.eval_shape(jax.random.key_data, leaf) if _is_key(leaf) else leaf


def _alike(found: Any, wanted: Any) -> bool:
    return found.shape == wanted.shape and found.dtype == wanted.dtype


def _placed(array: np.ndarray, like: Any) -> Any:
    sharding = getattr(like, "sharding", None)
    if sharding is None:
        return array
    if _is_key(like):
        return jax.random.wrap_key_data(_spread(array, sharding))
    return _spread(array, sharding)


def _spread(array: np.ndarray, sharding: Any) -> jax.Array:
    """Each process takes what its own devices need."""
    return jax.make_array_from_callback(array.shape, sharding, lambda part: array[part])
