"""A training that is killed a few times ends as one left alone; `kills.py` does it fifty times."""

import random
import subprocess

import kills


def test_a_killed_training_loses_nothing(tmp_path):
    iterations, cache = 60, tmp_path / "cache"
    subprocess.run(kills.command(tmp_path / "whole", cache, iterations), check=True, timeout=600)
    struck = kills.kill_and_go_on(tmp_path / "killed", cache, iterations, 3, random.Random(5))
    assert struck >= 1
    assert kills.digest(tmp_path / "killed") == kills.digest(tmp_path / "whole")
