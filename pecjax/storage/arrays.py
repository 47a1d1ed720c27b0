"""Array files: a pytree of arrays as one .npz file, whole or not there, and read without pickle.

NumPy's format keeps a checksum of every array; `docs/reliability.md` has what writing one costs.
Names, shapes and types are compared with what is wanted before any array is read, so that a file
from a stranger takes no more memory than the wanted arrays do.
"""

from __future__ import annotations

import json
import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pecjax.errors import InputError
from pecjax.runtime.distributed import is_primary, on_host
from pecjax.settings_tree import differences
from pecjax.storage.files import replacing


class CorruptFileError(Exception):
    """A file is not what was written."""


_ABOUT = "about"
_MAX_ABOUT = 2**20  # bytes
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

    Where several processes share a training, all of them call it and the primary process writes.

    Args:
        about: what the arrays belong to, as JSON.
    """
    named, _ = jax.tree_util.tree_flatten_with_path(tree)
    arrays = {jax.tree_util.keystr(place): on_host(_plain(leaf)) for place, leaf in named}
    if not is_primary():
        return
    if about is not None:
        arrays[_ABOUT] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    path.parent.mkdir(exist_ok=True)
    new = path.with_name(f".{path.name}")
    save: Any = np.savez  # whose own arguments no place in a tree is named like
    with replacing(path, new), new.open("wb") as file:
        save(file, **arrays)


def by_iteration(folder: Path, iteration: int) -> Path:
    """Where a folder keeps the arrays of an iteration."""
    return folder / f"{iteration}.npz"


def iterations_in(folder: Path) -> list[int]:
    """The iterations that a folder keeps arrays of, rising."""
    return sorted(int(path.stem) for path in folder.glob("*.npz") if path.stem.isdigit())


def read_arrays(
    path: Path,
    like: Any,
    about: dict[str, Any] | None = None,
) -> Any:
    """Reads a tree back, its leaves placed on the devices where those of `like` have a sharding.

    Args:
        like: a tree of the same structure, of arrays or their shapes.
        about: what the arrays must belong to, if that matters.

    Raises:
        CorruptFileError: the file is corrupt.
        InputError: it is whole, but belongs to something else.
    """
    named, structure = jax.tree_util.tree_flatten_with_path(like)
    wanted = {jax.tree_util.keystr(place): leaf for place, leaf in named}
    try:
        with path.open("rb") as opened, zipfile.ZipFile(opened) as file:
            found = _headers(file)
            written = _read_about(file, found)
            if about is not None:
                differing = list(differences(written, json.loads(json.dumps(about))))
                _check(path, file, differing, "belongs to a run that differs in")
            plain = {name: _plain_shape(leaf) for name, leaf in wanted.items()}
            differing = sorted(set(found) ^ set(plain)) or [
                name for name, leaf in plain.items() if found[name] != (leaf.shape, leaf.dtype)
            ]
            _check(
                path, file, differing, "was written with other settings or by another version; it differs in"
            )
            arrays = {name: _read(file, name) for name in plain}
    except InputError:
        raise
    except _UNREADABLE as error:
        raise CorruptFileError(f"{path}: corrupt ({error})") from error
    return jax.tree.unflatten(structure, [_placed(arrays[name], leaf) for name, leaf in wanted.items()])


def read_plain_arrays(path: Path, advice: str = "train again") -> dict[str, np.ndarray]:
    """Reads back what `write_arrays` wrote of a dictionary of arrays, whatever they are.

    Args:
        advice: what to do about a file that cannot be read.

    Raises:
        InputError: there is no such file, or it is corrupt.
    """
    try:
        with path.open("rb") as opened, zipfile.ZipFile(opened) as file:
            return {_key(name): _read(file, name) for name in _headers(file)}
    except _UNREADABLE as error:
        raise InputError(f"{path}: cannot be read ({error}); {advice}") from error


def _key(place: str) -> str:
    """A dictionary's key from its place in the tree, "['key']"."""
    return place.removeprefix("['").removesuffix("']")


def _headers(file: zipfile.ZipFile) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    """Shape and type of every array, each of which takes as much memory as it takes of the file.

    Raises:
        ValueError: a part is no array as NumPy writes them.
    """
    found = {}
    for part in file.infolist():
        name = part.filename.removesuffix(".npy")
        if part.compress_type != zipfile.ZIP_STORED or name == part.filename or name in found:
            raise ValueError(f"'{part.filename[:60]}' is no plain array")
        with file.open(part) as opened:
            if np.lib.format.read_magic(opened) != (1, 0):
                raise ValueError(f"'{part.filename[:60]}' has a header of another version")
            shape, _, dtype = np.lib.format.read_array_header_1_0(opened)
            size = opened.tell() + math.prod(shape) * dtype.itemsize
        if dtype.hasobject or size != part.file_size:
            raise ValueError(f"'{part.filename[:60]}' is no array of {shape} {dtype}")
        found[name] = (shape, dtype)
    return found


def _read_about(file: zipfile.ZipFile, found: dict[str, Any]) -> Any:
    """Takes what the arrays belong to out of those found."""
    shape, dtype = found.pop(_ABOUT, ((0,), np.uint8))
    if dtype != np.uint8 or math.prod(shape) > _MAX_ABOUT:
        raise ValueError("what it belongs to is no text")
    return json.loads(_read(file, _ABOUT).tobytes()) if math.prod(shape) else {}


def _read(file: zipfile.ZipFile, name: str) -> np.ndarray:
    with file.open(f"{name}.npy") as opened:
        return np.lib.format.read_array(opened, allow_pickle=False)


def _check(path: Path, file: zipfile.ZipFile, differing: list[str], says: str) -> None:
    """Refuses a file that differs, if it is whole: then it is another one."""
    if not differing:
        return
    if file.testzip() is not None:  # a checksum is wrong; reads piece by piece
        raise zipfile.BadZipFile("a checksum is wrong")
    more = f" and {len(differing) - 3} more" if len(differing) > 3 else ""
    raise InputError(
        f"{path}: {says} {', '.join(differing[:3])}{more}; restore the run's files, or train anew in another "
        "folder"
    )


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _plain(leaf: Any) -> Any:
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _plain_shape(leaf: Any) -> Any:
    return jax.eval_shape(jax.random.key_data, leaf) if _is_key(leaf) else leaf


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
