"""The pictures of paper.md that the tables of docs/results hold all numbers of.

    python docs/results_pictures.py              # into docs/images/results

The others are in the folders of their studies: `pecjax figures STUDY` draws them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import pandas as pd
from matplotlib.figure import Figure

from pecjax.plotting.study_ends import alphas, steps_to_threshold
from pecjax.plotting.style import STYLE, set_title

HERE = Path(__file__).parent
TITLES = {
    "fig14": "Ape-X DQN on set 1",
}
DPI = 200


def figures_of(name: str) -> dict[str, Figure]:
    """The figures of one study, by the name of their file."""
    runs = pd.read_csv(HERE / "results" / f"{name}-runs.csv")
    runs = runs.rename(columns=lambda column: column.replace("steps_until", "steps_to"))  # as it was called
    figures = {f"{name}-steps": steps_to_threshold(runs)}
    if runs.alpha.nunique() > 1:
        figures[f"{name}-alpha"] = alphas(runs)
    return figures


def main(words: list[str] | None = None) -> None:
    """Draws them all."""
    parser = argparse.ArgumentParser(description="Pictures of paper.md, from the tables beside it.")
    parser.add_argument("--out", type=Path, default=HERE / "images" / "results")
    out = parser.parse_args(words).out
    out.mkdir(parents=True, exist_ok=True)
    for name, title in TITLES.items():
        for stem, figure in figures_of(name).items():
            set_title(figure, title)
            with matplotlib.rc_context(STYLE):
                figure.savefig(out / f"{stem}.png", dpi=DPI)


if __name__ == "__main__":
    main()
