"""docs/wrappers.md: its Python is Python, and the loop that it begins with runs as it stands."""

import ast
import re
from pathlib import Path

import jax
import numpy as np
import pytest

PAGE = Path(__file__).parents[1] / "docs" / "wrappers.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_any_loop():
    done = np.array([[True, False, True], [False, False, True]])
    names = {"N": 4, "B": 3, "key": jax.random.key(0), "done": done, "failed": np.ones((2, 3), bool)}
    exec(BLOCKS[0], names)
    tally = np.zeros(4, int)
    np.add.at(tally, np.broadcast_to(names["ids"], done.shape)[done], 1)
    np.testing.assert_array_equal(names["state"].statistics, [tally, tally])


@pytest.mark.parametrize("block", BLOCKS[1:], ids=lambda block: block[:20])
def test_code_is_python_and_its_imports_of_pecjax_exist(block):
    for node in ast.walk(ast.parse(block)):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] == "pecjax":
            library = node.module.rpartition(".")[2] if ".wrappers." in node.module else "pecjax"
            if library != "chooser":
                pytest.importorskip(library)
            module = __import__(node.module, fromlist=[name.name for name in node.names])
            assert all(hasattr(module, name.name) for name in node.names), node.module
