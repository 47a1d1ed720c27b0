"""MJCF files from anyone: read within bounds, and nothing outside their folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat

import mujoco
import numpy as np

from pecjax.errors import InputError

MAX_BYTES = 2**20  # of one file
MAX_FILES = 20  # that a map may include
MAX_ELEMENTS = 20_000
MAX_NUMBER = 4096  # pixels, rows, copies: what MuJoCo makes as many of, before anything can be checked
MAX_MEMORY = 2**28  # bytes that a map may ask MuJoCo for
_COUNTS = {"width", "height", "nrow", "ncol", "count", "resolution", "gridsize", "vertcollide"}
_FOLDERS = {"meshdir", "texturedir", "assetdir"}
_FILES = {"file", "fileright", "fileup", "fileleft", "filedown", "filefront", "fileback"}
_NUMBERS = (
    *("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "qpos0"),
    *("geom_pos", "geom_quat", "geom_size", "site_pos", "site_quat", "numeric_data"),
    *("cam_pos", "cam_quat", "cam_fovy", "actuator_gear", "actuator_ctrlrange", "actuator_gainprm"),
)
_OPTIONS = ("timestep", "gravity", "wind", "density", "viscosity", "impratio", "tolerance")
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}


def compile_mjcf(path: Path) -> mujoco.MjModel:
    """Compiles an MJCF file once it and all that it includes have been looked through.

    Raises:
        InputError: it is missing, is no MJCF, declares entities, asks for absurd amounts, or for
            files outside its folder.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such scene file; give the path of an MJCF file")
    _look_through(path)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{path}: MuJoCo cannot compile it: {error}") from error
    numbers = {name: getattr(model, name) for name in _NUMBERS}
    numbers |= {f"option {name}": getattr(model.opt, name) for name in _OPTIONS}
    for name, value in numbers.items():
        if not np.all(np.abs(value) < mujoco.mjMAXVAL):
            raise InputError(f"{path}: {name} holds a number that is not finite or far too large")
    return model


def _look_through(path: Path) -> None:
    """Reads every element of the map and of its includes, none of which may lie elsewhere."""
    home = path.resolve().parent
    waiting, seen, elements = [path], set(), 0
    while waiting:
        file = waiting.pop()
        if len(seen) >= MAX_FILES:
            raise InputError(f"{path}: includes more than {MAX_FILES} files; put them together")
        seen.add(file.resolve())
        for tag, attributes in _elements(path, file):
            elements += 1
            if elements > MAX_ELEMENTS:
                raise InputError(f"{path}: has more than {MAX_ELEMENTS} elements; a map needs fewer")
            _check_amounts(path, tag, attributes)
            for name in (_FOLDERS | _FILES) & set(attributes):
                target = home / attributes[name]
                if not target.resolve().is_relative_to(home):
                    raise InputError(
                        f'{path}: <{tag} {name}="{attributes[name]}"> lies outside the map\'s folder; '
                        "put what it needs beside the map"
                    )
                if tag == "include" and target.resolve() not in seen:
                    waiting.append(target)


def _elements(path: Path, file: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Tags and attributes of one file, in the order they stand."""
    found: list[tuple[str, dict[str, str]]] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, attributes: found.append((tag, attributes))
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        with file.open("rb") as opened:
            content = opened.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise InputError(f"{file}: is larger than {MAX_BYTES:,} bytes; a map is smaller")
        parser.Parse(content, True)
    except (expat.ExpatError, ValueError, LookupError, OSError) as error:
        if isinstance(error, InputError):
            raise
        place = "" if file == path else f"{path}: includes "
        raise InputError(f"{place}{file}: not XML ({error}); give an MJCF file") from error
    yield from found


def _refuse_doctype(*_: object) -> None:
    raise ValueError("declares a document type or entities, which no MJCF file needs")


def _check_amounts(path: Path, tag: str, attributes: dict[str, str]) -> None:
    """Refuses what would take more memory or time than any map needs."""
    for name, text in attributes.items():
        if tag == "size" and name == "memory":
            if _bytes(text) > MAX_MEMORY:
                raise InputError(f'{path}: <size memory="{text}"> is more than a map needs; leave it out')
        elif name in _COUNTS or tag == "size" or name.startswith("nuser"):
            for word in text.split():
                if _number(word) > MAX_NUMBER:
                    raise InputError(
                        f'{path}: <{tag} {name}="{text[:40]}"> is too much; {MAX_NUMBER} is the most'
                    )


def _number(word: str) -> float:
    try:
        return abs(float(word))
    except ValueError:
        return 0.0  # MuJoCo says what is wrong with it


def _bytes(text: str) -> float:
    return _number(text[:-1]) * _UNITS.get(text[-1:].upper(), 1) if text[-1:].isalpha() else _number(text)
