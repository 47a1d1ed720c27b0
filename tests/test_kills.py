"""What is killed a few times ends as what is left alone; `kills.py` does it fifty times."""

import random
import subprocess

import kills
import pytest

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("victim", [kills.training(60), kills.study(3)], ids=["training", "study"])
def test_what_is_killed_loses_nothing(victim, tmp_path):
    cache = tmp_path / "cache"
    subprocess.run(victim.command(tmp_path / "whole", cache), check=True, timeout=600)
    struck = kills.kill_and_resume(victim, tmp_path / "killed", cache, 3, random.Random(5))
    assert struck >= 1
    assert victim.digest(tmp_path / "killed") == victim.digest(tmp_path / "whole")
