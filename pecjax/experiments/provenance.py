"""Provenance: versions, machine and commit, what a figure needs to be believed."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import jax

_PACKAGES = ("pecjax", "jax", "mujoco", "mujoco-mjx", "flax", "optax", "numpy")


def environment_facts(num_devices: int) -> dict[str, Any]:
    """Versions, machine, devices and git commit: what a figure needs to be believed."""
    return {
        "versions": {name: importlib.metadata.version(name) for name in _PACKAGES}
        | {"python": platform.python_version()},
        "machine": {"system": platform.platform(), "cores": os.cpu_count(), "processor": _processor()},
        "devices": {
            "kind": jax.devices()[0].device_kind,
            "used": num_devices,
            "available": len(jax.devices()),
        },
        "git_commit": git_commit(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def git_commit() -> str | None:
    """The commit of the checkout this package runs from, None outside one."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()
