"""MJX and Brax, without the line that MJX prints to stdout where its optional Warp back-end is absent."""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from brax.envs.base import Env, State
    from mujoco import mjx

__all__ = ["Env", "State", "mjx"]
