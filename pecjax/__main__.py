"""The entry to the command line: `pecjax`, and `python -m pecjax`."""

import importlib
import os
import sys


def main() -> int:
    """Runs one command; returns its exit code."""
    try:
        importlib.import_module("mujoco")  # where MUJOCO_GL names an OpenGL, this looks for it
    except Exception as error:
        if "MUJOCO_GL" not in os.environ:
            raise
        named = os.environ["MUJOCO_GL"]
        print(
            f"pecjax: MuJoCo cannot draw here (no OpenGL): MUJOCO_GL={named} does not work ({error}); "
            "install it, or set MUJOCO_GL=disabled",
            file=sys.stderr,
        )
        return 2
    from pecjax import cli

    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
