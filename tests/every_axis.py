"""A file of three configurations that differ in every axis."""

import pecjax
from pecjax.envs.axes import columns_of

ROWS = """\
0,-2,5,-2,0.5,1,0,0,0.5,0.1,0.95,6,0.02,0.05,1,0,0,0
-5,0,-5,5,-2,0,2,0.5,1,0.2,0.9,3,0.05,0,0,1,0,0
3,-5,3,-2,3,-1,-1,0,0.2,0,1,20,0,0.1,2,2,5,-7
"""


def write_table(path):
    """Writes the file; returns its path."""
    header = ",".join(name for name in columns_of(pecjax.Configurations) if name != "map")
    path.write_text(f"{header}\n{ROWS}")
    return path
