"""Amounts: how much an MJCF file asks MuJoCo to make, added up before MuJoCo reads it."""

from __future__ import annotations

import math

from pecjax.errors import InputError

MAX_ELEMENTS = 10_000  # with every copy that <replicate> makes of them
MAX_BODIES = 4096  # the same; MuJoCo's time grows with their square
MAX_NUMBER = 4096  # pixels, rows, copies
MAX_PER_ELEMENT = 256  # numbers that each of thousands of elements may ask for
MAX_MEMORY = 2**28  # bytes, of all textures, height fields and generated meshes together

_COUNTS = {"width", "height", "nrow", "ncol", "count", "resolution", "gridsize"}
_SIZE = ("width", "height", "nchannel")  # of a texture
_SMALL_COUNTS = {"nsample", "dim", "num", "actdim", "nchannel"}
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}
_VERTEX = 4096  # bytes; more than one takes, since the time for its convex hull counts too
_SELF_CONTAINED = "write its bodies into the map, or take them in with <include>"
_NOTHING_MOVES = "nothing but the drone may move; build it of boxes"
_REFUSED = {
    "model": _SELF_CONTAINED,
    "attach": _SELF_CONTAINED,
    "composite": _NOTHING_MOVES,
    "flexcomp": _NOTHING_MOVES,
    "flex": _NOTHING_MOVES,
    "plugin": "MJX has no plugins; take it out",
    "tactile": "a map needs no such sensor; take it out",
    "lengthrange": "a map needs no such simulation; take it out",
}


class Amounts:
    """Adds up a map's elements in the order they stand, those of its includes in their place."""

    def __init__(self) -> None:
        """Nothing has been asked for yet."""
        self._open: list[tuple[str, float]] = []  # elements around, each with the copies made of its content
        self._elements = self._bodies = self._bytes = 0.0
        self._textures: list[dict[str, str]] = []
        self._defaults: dict[str, float] = {}  # of textures, the largest of all classes

    def begin(self, place: str, tag: str, attributes: dict[str, str]) -> None:
        """Counts an element.

        Args:
            place: file and line, for messages.

        Raises:
            InputError: the element is of a kind that no map needs, or the map is too large with it.
        """
        if tag in _REFUSED:
            raise InputError(f"{place}: <{tag}> is not read; {_REFUSED[tag]}")
        if tag == "rangefinder" and "camera" in attributes:
            raise InputError(f"{place}: <rangefinder camera=…> is not read; take it out")
        for name, text in attributes.items():
            _check_attribute(place, tag, name, text)
        copies = self._open[-1][1] if self._open else 1.0
        if tag == "replicate":
            copies *= max(_numbers(attributes.get("count", "1"), 1.0))
        self._elements += copies
        self._bodies += copies * (tag == "body")
        if self._elements > MAX_ELEMENTS or self._bodies > MAX_BODIES:
            raise InputError(
                f"{place}: here the map exceeds {MAX_ELEMENTS:,} elements or {MAX_BODIES:,} bodies, copies "
                "of <replicate> counted; a map needs fewer"
            )
        if tag == "texture" and any(around == "default" for around, _ in self._open):
            for name in _SIZE:
                value = max(_numbers(attributes.get(name, "0"), 0.0))
                self._defaults[name] = max(value, self._defaults.get(name, 0.0))
        elif tag == "texture":
            self._textures.append(attributes)
        elif tag == "hfield":
            rows, columns = (max(_numbers(attributes.get(name, "0"), 0.0)) for name in ("nrow", "ncol"))
            self._bytes += 4 * rows * columns
        elif tag == "mesh" and "params" in attributes:  # a resolution among them counts in both directions
            self._bytes += _VERTEX * max(_numbers(attributes["params"], 0.0)) ** 2
        self._open.append((tag, copies))

    def end(self) -> None:
        """Leaves the element that was started last."""
        self._open.pop()

    def finish(self, place: str) -> None:
        """Adds up what could not be known before the last element.

        Raises:
            InputError: the map would take too much memory.
        """
        for attributes in self._textures:
            size = self._defaults | {n: max(_numbers(attributes[n], 0.0)) for n in _SIZE if n in attributes}
            width, height, channels = (size.get(name, 0.0) for name in _SIZE)
            # All but flat pictures have six square faces.
            pixels = width * height if attributes.get("type") == "2d" else 6 * width * max(width, height)
            self._bytes += max(channels, 3.0) * pixels
        if self._bytes > MAX_MEMORY:
            raise InputError(
                f"{place}: its textures, height fields and meshes would take {self._bytes / 1e6:,.0f} MB; "
                f"{MAX_MEMORY / 1e6:,.0f} MB is the most, make them smaller"
            )


def _check_attribute(place: str, tag: str, name: str, text: str) -> None:
    what = f'{place}: <{tag} {name}="{text[:40]}">'
    if tag == "size" and name == "memory":
        if not _bytes(text) <= MAX_MEMORY:
            raise InputError(f"{what} is more than a map needs; leave it out")
    elif name in _COUNTS | _SMALL_COUNTS or tag == "size":
        small = name in _SMALL_COUNTS or name.startswith("nuser_")
        most = MAX_PER_ELEMENT if small else MAX_NUMBER
        if not max(_numbers(text, 0.0)) <= most:
            raise InputError(f"{what} is too much or no number; {most} is the most")


def _numbers(text: str, least: float) -> list[float]:
    """The numbers of an attribute without their signs, infinite where a word is none."""
    return [least] + [_number(word) for word in text.split()]


def _number(word: str) -> float:
    try:
        value = abs(float(word))
    except ValueError:
        return math.inf
    return math.inf if math.isnan(value) else value


def _bytes(text: str) -> float:
    return _number(text[:-1]) * _UNITS.get(text[-1:].upper(), 1) if text[-1:].isalpha() else _number(text)
