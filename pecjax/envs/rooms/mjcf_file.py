"""Map files from anyone, MJCF or text plans: read within bounds, and nothing outside their folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

import mujoco
import numpy as np

from pecjax.envs.rooms.default_drone import add_default_drone
from pecjax.envs.rooms.mjcf_amounts import Amounts
from pecjax.envs.rooms.mjcf_assets import leave_out_assets
from pecjax.envs.rooms.text_plan import SUFFIX, read_text_plan
from pecjax.errors import InputError

MAX_BYTES = 2**20  # of one file
MAX_FILES = 20  # that a map may include
_FOLDERS = {"meshdir", "texturedir", "assetdir"}
_FILES = {"file", "fileright", "fileup", "fileleft", "filedown", "filefront", "fileback"}
_NUMBERS = (
    *("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "qpos0"),
    *("geom_pos", "geom_quat", "geom_size", "site_pos", "site_quat", "numeric_data"),
    *("cam_pos", "cam_quat", "cam_fovy", "actuator_gear", "actuator_ctrlrange", "actuator_gainprm"),
)
_OPTIONS = ("timestep", "gravity", "wind", "density", "viscosity", "impratio", "tolerance")


@dataclass(frozen=True)
class MapFile:
    """A map as it was read.

    Attributes:
        path: the file.
        text: the map with all that it includes, without the assets that are only for show, as MuJoCo
            saves it: numbers have six digits. Reading it again gives the same text.
        model: `text` compiled.
        geom_places: where each geom of the model stands, "path, line 12"; the path alone where the
            line is not known.
        joints: (name, body, place) of each joint.
        notices: what was added or put in the place of what the file says, for people.
    """

    path: Path
    text: str
    model: mujoco.MjModel
    geom_places: tuple[str, ...]
    joints: tuple[tuple[str, str, str], ...]
    notices: tuple[str, ...] = ()

    def geom(self, number: int) -> str:
        """A geom's place and name, for messages."""
        name = self.model.geom(number).name
        return f"{self.geom_places[number]}: geom " + (f"'{name}'" if name else f"{number}")


def read_map_file(path: Path, approximate: float | None = None) -> MapFile:
    """Reads an MJCF file or a text plan once it and all that it includes have been looked through.

    What is flown is the map as it would be saved, so that a run and its saved map are the same. Walls alone
    get the default drone.

    Args:
        approximate: m, how far boxes may reach beyond the shapes that they stand for (see
            `approximation.approximate_shapes`); None to leave shapes as they are.

    Raises:
        InputError: it is missing, is no MJCF, declares entities, asks for absurd amounts, for files
            outside its folder, for files that it cannot do without, or cannot be approximated so.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such scene file; give the path of an MJCF file")
    notices: list[str] = []
    try:
        spec, place = _open(path)
        if _is_walls_alone(spec):
            add_default_drone(spec)
            if path.suffix != SUFFIX:
                notices.append("there is no body named 'drone'; the drone of the six rooms is added")
        leave_out_assets(spec, place, but_solid_meshes=approximate is not None)
        model = spec.compile()
        _check_numbers(path, model)  # what is not finite would be left out of the text
        if approximate is not None:
            from pecjax.envs.rooms.approximation import approximate_shapes  # SciPy takes long to import

            notices += approximate_shapes(spec, model, approximate, place)
            leave_out_assets(spec, place)
            spec.compile()
        text = spec.to_xml()
        geoms = {geom.id: place("geom", geom) for geom in spec.geoms}
        joints = tuple((joint.name, joint.parent.name, place("joint", joint)) for joint in spec.joints)
        text = _settled(text)
        model = mujoco.MjModel.from_xml_string(text)
    except InputError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{path}: MuJoCo cannot compile it: {error}") from error
    geom_places = tuple(geoms.get(geom, str(path)) for geom in range(model.ngeom))
    return MapFile(path, text, model, geom_places, joints, tuple(notices))


def _open(path: Path) -> tuple[mujoco.MjSpec, Callable[[str, Any], str]]:
    """What the file says, and where each of its elements stands."""
    if path.suffix != SUFFIX:
        looked_through = _LookThrough(path)
        return mujoco.MjSpec.from_file(str(path)), looked_through.place_of
    try:
        text = _read_bytes(path).decode("utf-8-sig")
    except (UnicodeDecodeError, OSError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}); give a text plan") from error
    return read_text_plan(path, text), lambda *_: str(path)


def _read_bytes(path: Path) -> bytes:
    with path.open("rb") as opened:
        content = opened.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise InputError(f"{path}: is larger than {MAX_BYTES:,} bytes; a map is smaller")
    return content


def _is_walls_alone(spec: mujoco.MjSpec) -> bool:
    return spec.body("drone") is None and not spec.joints and not spec.actuators


def _check_numbers(path: Path, model: mujoco.MjModel) -> None:
    numbers = {name: getattr(model, name) for name in _NUMBERS}
    numbers |= {f"option {name}": getattr(model.opt, name) for name in _OPTIONS}
    for name, value in numbers.items():
        if not np.all(np.abs(value) < mujoco.mjMAXVAL):
            raise InputError(f"{path}: {name} holds a number that is not finite or far too large")


def _settled(text: str) -> str:
    """The text that saving it again would not change: quaternions may move in their last digit."""
    for _ in range(5):
        before, text = text, mujoco.MjSpec.from_string(text).to_xml()
        if text == before:
            break
    return text


class _LookThrough:
    """Reads every element of a map and, in their places, of its includes, none of which lies elsewhere."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._home = path.parent.resolve()  # MuJoCo looks for files beside the map, as it was named
        self._amounts = Amounts()
        self._files = 0
        self._named: dict[tuple[str, str], str] = {}  # kind and name -> place
        self._read(path)
        self._amounts.finish(str(path))

    def place_of(self, kind: str, element: Any) -> str:
        """Where an element of an MjSpec stands, "path, line 12", as far as that is known."""
        named = self._named.get((kind, element.name)) if element.name else None
        if named is None and self._files == 1 and element.info.startswith("line "):
            named = f"{self._path}, {element.info}"
        return named or str(self._path)

    def _read(self, file: Path) -> None:
        self._files += 1
        if self._files > MAX_FILES:
            raise InputError(f"{self._path}: includes more than {MAX_FILES} files; put them together")
        parser = expat.ParserCreate()
        parser.StartElementHandler = lambda tag, attributes: self._begin(
            file, parser.CurrentLineNumber, tag, attributes
        )
        parser.EndElementHandler = lambda _: self._amounts.end()
        parser.StartDoctypeDeclHandler = _refuse_doctype
        try:
            parser.Parse(_read_bytes(file), True)
        except (expat.ExpatError, ValueError, LookupError, OSError) as error:
            if isinstance(error, InputError):
                raise
            place = "" if self._files == 1 else f"{self._path}: includes "
            raise InputError(f"{place}{file}: not XML ({error}); give an MJCF file") from error

    def _begin(self, file: Path, line: int, tag: str, attributes: dict[str, str]) -> None:
        place = f"{file}, line {line}"
        self._amounts.begin(place, tag, attributes)
        kind = "joint" if tag == "freejoint" else tag
        self._named.setdefault((kind, attributes.get("name", "")), place)
        for name in (_FOLDERS | _FILES) & set(attributes):
            target = self._home / attributes[name]
            if not target.resolve().is_relative_to(self._home):
                raise InputError(
                    f'{place}: <{tag} {name}="{attributes[name][:200]}"> lies outside the map\'s folder; '
                    "put what it needs beside the map"
                )
            if tag == "include" and name == "file":
                self._read(target)


def _refuse_doctype(*_: object) -> None:
    raise ValueError("declares a document type or entities, which no MJCF file needs")
