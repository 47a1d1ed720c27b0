"""The page: flights in three dimensions in one HTML file, which loads nothing from anywhere.

Three.js draws them: its minified code is a part of the file.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
from importlib import resources
from typing import Any

import numpy as np

from pecjax.envs.rooms.map_file import Map
from pecjax.viewing.history import History
from pecjax.viewing.recording import Flight, Recording, drawn_walls

IMAGE_PIXELS = 768  # the most that an image keeps; a larger one is made smaller by a whole factor
ALL_PIXELS = 4_000_000  # the most of all images; beyond it some in between are left out
_PAGE, _STYLE = "page/page.html", "page/style.css"
_SCRIPTS = ("three/three.min.js", "page/data.js", "page/world.js", "page/panels.js", "page/player.js")


def page(recording: Recording, history: History | None = None) -> str:
    """The text of the page.

    Args:
        history: how the configurations were drawn in training, where that is to be shown.
    """
    files = resources.files("pecjax.viewing")
    text = {
        name: (files / name).read_text("utf-8") for name in (*_SCRIPTS, "page/page.html", "page/style.css")
    }
    parts = {
        "title": html.escape(recording.title),
        "style": text[_STYLE],
        "data": _packed(*_content(recording, history)),
        "scripts": "\n".join(text[name] for name in _SCRIPTS),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], text[_PAGE])


def _content(recording: Recording, history: History | None) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the page is told, and its arrays by name."""
    task, flights = recording.task, recording.flights
    images, about = _images(flights, task.vehicle.camera.far)
    lengths = np.array([len(flight.commands) for flight in flights])
    header: dict[str, Any] = {
        "period": task.settings.control_period,
        "droneRadius": task.vehicle.radius,
        "goalRadius": task.settings.goal_radius,
        "depthAbout": about | {"near": task.vehicle.camera.near, "far": task.vehicle.camera.far},
        "maps": {str(number): _map(one) for number, one in recording.maps.items()},
        "flights": [],
    }
    first, first_image = 0, 0
    for flight, length in zip(flights, lengths.tolist(), strict=True):
        about_flight = {
            "config": flight.config_id,
            "map": flight.map_id,
            "ending": flight.ending,
            "goal": flight.goal.tolist(),
            "goalRadius": task.settings.goal_radius,
            "length": length,
            "first": first,
            "firstImage": first_image,
            "askedSpeed": flight.commands[:, 0].round(3).tolist(),
            "askedYawRate": flight.commands[:, 1].round(3).tolist(),
        }
        if flight.waypoint is not None:
            about_flight["waypoint"] = flight.waypoint.tolist()
        header["flights"].append(about_flight)
        first, first_image = first + length + 1, first_image + length // about["stride"] + 1
    arrays = {"poses": np.concatenate([flight.poses for flight in flights]).astype("<f4"), "depth": images}
    if history is not None:
        header["history"] = _history(history)
        arrays["relative"] = history.relative.astype("<f4")
    return header, arrays


def _images(flights: tuple[Flight, ...], far: float) -> tuple[np.ndarray, dict[str, int]]:
    """Depth images as bytes, 255 for `far`, those of one flight after those of another."""
    height, width = flights[0].depth.shape[1:]
    factor = next(n for n in range(1, height + width) if (height // n) * (width // n) <= IMAGE_PIXELS)
    smaller = [flight.depth[:, factor // 2 :: factor, factor // 2 :: factor] for flight in flights]
    stride = -(-sum(images.size for images in smaller) // ALL_PIXELS)
    kept = np.concatenate([images[::stride] for images in smaller])
    height, width = kept.shape[1:]
    return np.round(255 * kept / far).astype(np.uint8), {"height": height, "width": width, "stride": stride}


def _map(about: Map) -> dict[str, Any]:
    walls = zip(*(part.tolist() for part in drawn_walls(about)), strict=True)
    return {
        "bounds": about.bounds.tolist(),
        "walls": [{"lower": lower, "upper": upper, "cover": cover} for lower, upper, cover in walls],
    }


def _history(history: History) -> dict[str, Any]:
    number, shown = history.num_configs, len(history.map_id)
    return {
        "iterations": history.iterations.tolist(),
        "starts": history.starts.tolist(),
        "goals": history.goals.tolist(),
        "maps": history.map_id.tolist(),
        "caption": f"all {number} configurations"
        if shown == number
        else f"{shown} of {number} configurations",
    }


def _packed(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> str:
    """Header and arrays as `data.js` reads them: gzip of length, JSON and bytes, in base64."""
    places = [{"name": name, "type": array.dtype.name, "size": array.size} for name, array in arrays.items()]
    offset = 0
    for place, array in zip(places, arrays.values(), strict=True):
        place["offset"] = offset  # from the end of the header
        offset += -(-array.nbytes // 4) * 4
    text = json.dumps(header | {"arrays": places}, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)  # arrays begin at a multiple of their numbers' size
    body = b"".join(array.tobytes() + b"\0" * (-array.nbytes % 4) for array in arrays.values())
    packed = gzip.compress(len(text).to_bytes(4, "little") + text + body, mtime=0)
    return base64.b64encode(packed).decode()
