"""Systems that lack what Linux has: all of pecjax imports there, and a folder is still for one run alone."""

import subprocess
import sys

import pytest

from pecjax import InputError
from pecjax.storage.files import alone

# As on systems without `fcntl`; macOS does not tell which cores a process may use.
LACKING = """
import importlib, os, pkgutil, sys
sys.modules["fcntl"] = None
del os.sched_getaffinity
"""
IMPORT_ALL = """
import pecjax
for module in pkgutil.walk_packages(pecjax.__path__, "pecjax."):
    if module.name != "pecjax.__main__":
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as error:  # of an extra
            assert error.name.partition(".")[0] not in ("pecjax", "fcntl"), error
from pecjax.runtime.devices import num_cores
assert num_cores() >= 1
"""
LOCK = """
from pathlib import Path
from pecjax import InputError
from pecjax.storage.files import alone, check_free
folder = Path(sys.argv[1])
with alone(folder):
    try:
        with alone(folder):
            raise SystemExit("two at once")
    except InputError as error:
        assert "another process trains here" in str(error), error
with alone(folder):
    check_free(folder)
"""
HOLD = """
import sys, time
from pathlib import Path
from pecjax.storage.files import alone
with alone(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_all_of_it_imports_and_locks_where_modules_of_linux_are_missing(tmp_path):
    words = [sys.executable, "-c", LACKING + IMPORT_ALL + LOCK, str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_lock_is_gone_with_its_process_however_it_ends(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="another process trains here"), alone(tmp_path):
            pass
    finally:
        holder.kill()
        holder.wait()
        holder.stdout.close()
    with alone(tmp_path):
        pass
