"""`python -m pecjax`: the command line."""

import sys

from pecjax.cli import main

if __name__ == "__main__":
    sys.exit(main())
