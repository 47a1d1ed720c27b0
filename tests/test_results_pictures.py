"""docs/results_pictures.py: what it draws are the numbers of the stored tables."""

import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

DOCS = Path(__file__).parents[1] / "docs"
SPEC = importlib.util.spec_from_file_location("results_pictures", DOCS / "results_pictures.py")
pictures = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(pictures)


@pytest.mark.parametrize("name", pictures.TITLES)
def test_steps_are_those_of_the_table(name):
    table = pd.read_csv(DOCS / "results" / f"{name}-runs.csv")
    figures = pictures.figures_of(name)
    assert (f"{name}-alpha" in figures) == (name == "fig11")
    for axes, at in zip(figures[f"{name}-steps"].axes, ("0.9", "0.95"), strict=True):
        column = next(column for column in table if column in (f"steps_until_{at}", f"steps_to_{at}"))
        held = table[column][np.isfinite(table[column])] / 1e6
        drawn = np.concatenate(
            [np.ma.filled(marks.get_offsets(), np.nan)[:, 1] for marks in axes.collections]
        )
        assert len(drawn) == len(table), "runs that never held it have a mark too"
        np.testing.assert_allclose(np.sort(drawn)[: len(held)], np.sort(held))


def test_every_picture_is_one_of_the_page():
    page = (DOCS / "paper.md").read_text()
    for name in pictures.TITLES:
        for stem in pictures.figures_of(name):
            assert f"images/results/{stem}.png" in page
