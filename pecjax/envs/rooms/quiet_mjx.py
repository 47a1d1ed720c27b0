"""MJX, without the line that it prints to stdout where its optional Warp back-end is absent."""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

__all__ = ["mjx"]
