"""Provenance: versions, machine and commit, what a figure needs to be believed."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import jax

FACTS = ("versions", "machine", "devices", "git_commit")  # the names of `environment_facts`
_PACKAGES = ("pecjax", "jax", "mujoco", "mujoco-mjx", "flax", "optax", "numpy")


def session_facts(num_devices: int, from_iteration: int) -> dict[str, Any]:
    """One session of a run: the iteration it began after, when it started (UTC), `environment_facts`."""
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"from_iteration": from_iteration, "started": started} | environment_facts(num_devices)


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
    """The commit of the checkout that this file belongs to, None outside one.

    It ends in `-dirty` where tracked files of the package are not as in that commit.
    """
    here = Path(__file__).resolve()
    # A virtual environment may lie in a repository that knows nothing of what is installed there.
    if _git(here.parent, "ls-files", "--error-unmatch", here.name) is None:
        return None
    commit = _git(here.parent, "rev-parse", "HEAD")
    changed = _git(here.parents[1], "status", "--porcelain", "--untracked-files=no", "--", ".")
    return f"{commit}-dirty" if commit and changed else commit


def _git(folder: Path, *args: str) -> str | None:
    """What git prints of the repository that holds the folder; None where it fails."""
    # Variables such as GIT_DIR, which hooks and scripts set, would name another repository.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    command = ["git", "--no-optional-locks", "-C", str(folder), *args]
    try:
        found = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()


def short_commit(commit: str) -> str:
    """Its first seven digits, and `-dirty` where it has that."""
    return commit[:7] + "-dirty" * commit.endswith("-dirty")
