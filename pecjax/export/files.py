"""Files: a run's policy and its description, written side by side."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from pecjax.errors import InputError, nearest
from pecjax.export.description import describe
from pecjax.export.jax_program import jax_program
from pecjax.export.onnx_graph import onnx_model
from pecjax.export.policy import Policy, policy_of
from pecjax.runtime.extras import require
from pecjax.storage.files import json_text, replace_file, writing
from pecjax.training.demos import find_run, is_demo
from pecjax.training.load import open_run
from pecjax.training.run_directory import RunDirectory


class Format(NamedTuple):
    """A format that policies are exported to.

    Attributes:
        file: the file's name, where none is given.
        library: of the extra `export`, that it needs.
        serialized: (policy) -> the file's content.
    """

    file: str
    library: str
    serialized: Callable[[Policy], bytes]


FORMATS = {
    "onnx": Format("policy.onnx", "onnx", onnx_model),
    "jax": Format("policy_jax.bin", "flatbuffers", jax_program),
}


def export_policy(
    folder: str | Path, format: str = "onnx", out: str | Path | None = None, checkpoint: int | None = None
) -> tuple[Path, Path]:
    """Writes the policy of a run for other programs, and its description as JSON beside it.

    Args:
        folder: the run's, or the name of a demo.
        format: `onnx`, or `jax` for StableHLO that `jax.export.deserialize` reads.
        out: the file, which is replaced; when None, `policy.onnx` or `policy_jax.bin` in the run's folder, or
            of a demo in the current one. The description has the same name, but ends in .json.
        checkpoint: the iteration it was saved at, the newest when None.

    Returns:
        the two files.

    Raises:
        InputError: no such run, checkpoint or format, a network that is not one of ours, a library that is
            missing, or a file that cannot be written.
    """
    if format not in FORMATS:
        raise InputError(f"unknown format '{format}'{nearest(format, [*FORMATS])}; give onnx or jax")
    name, library, serialized = FORMATS[format]
    folder = Path(folder)
    out = Path(out or (name if is_demo(folder) else folder / name))
    if out.is_dir() or out.suffix == ".json":
        raise InputError(f"{out}: is a folder or ends in .json; give a file such as {name} with --out")
    described = out.with_suffix(".json")
    require(library, extra="export")
    trained = open_run(folder, checkpoint)
    policy = policy_of(trained)
    content = serialized(policy)
    about = {"format": format, "file": out.name, "sha256": hashlib.sha256(content).hexdigest()}
    about |= describe(RunDirectory(find_run(folder)), trained, policy)
    with writing(out, "give another file with --out"):
        out.parent.mkdir(parents=True, exist_ok=True)
        replace_file(out, content)
        replace_file(described, json_text(about))
    return out, described
