"""The picture of memory.md, from a table of all evaluations of its runs.

    python docs/memory_pictures.py                  # into docs/images/results; prints how the runs ended
    python docs/memory_pictures.py --runs FOLDER    # first puts runs of FOLDER/NETWORK-SEED into the table

NETWORK is one of `NETWORKS`. A run takes the place of that of the same network and seed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from pecjax.plotting.style import BLUE, PAGE, RED, STYLE, TEAL, YELLOW, legend_below

HERE = Path(__file__).parent
TABLE = HERE / "results" / "memory-floorplans.csv"
# By the name of their runs' folders: what they are, and seconds that every run has had.
NETWORKS = {
    "mlp": ("no memory", 540),
    "mingru": ("minGRU", 540),
    "mlp-falling": ("no memory, falling rate", 900),
    "mingru-falling": ("minGRU, falling rate", 900),
    "mlp-25": ("no memory, falling rate, 25 minutes", 1500),
    "mingru-25": ("minGRU, falling rate, 25 minutes", 1500),
    "mingru-far": ("minGRU, falling rate, discount 0.998, sequences of 128", 900),
    "mlp-paths": ("no memory, falling rate, critic told of paths", 900),
    "mingru-paths": ("minGRU, falling rate, critic told of paths", 900),
    "above": ("shown the map", 540),
    "guided": ("shown the way", 540),
}
PAIRS = (
    ("mlp", "mingru"),
    ("mlp-falling", "mingru-falling"),
    ("mlp-falling", "mingru-far"),
)
LOOKS = (
    *((color, dashes) for dashes in ("-", ":", "-.") for color in (RED, BLUE)),
    (BLUE, "--"),
    *((color, (0, (6, 1, 1, 1, 1, 1))) for color in (RED, BLUE)),
    (YELLOW, "-"),
    (TEAL, "-"),
)
DPI = 200


def collect(folder: Path) -> pd.DataFrame:
    """Every evaluation of the runs in a folder, with the seconds spent until then."""
    parts = []
    for run in sorted(folder.glob("*-*/evaluation.csv")):
        network, _, seed = run.parent.name.rpartition("-")
        seconds = pd.read_csv(run.with_name("metrics.csv")).set_index("iteration").seconds
        found = pd.read_csv(run)
        found.insert(0, "seconds", found.iteration.map(seconds))
        found.insert(0, "seed", int(seed))
        found.insert(0, "network", network)
        parts.append(found)
    return pd.concat(parts, ignore_index=True)


def joined(table: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """The table with new runs, in the order of `NETWORKS`."""
    run = ["network", "seed"]
    kept = table[~table.set_index(run).index.isin(new.set_index(run).index)]
    return pd.concat([kept, new]).sort_values(
        ["network", "seed", "iteration"], key=_in_order, ignore_index=True
    )


def ends(table: pd.DataFrame, column: str = "goal_ratio", last: int = 3) -> pd.DataFrame:
    """The mean of each run's last evaluations within the budget, a row a seed and a column a network."""
    budget = table.network.map({name: seconds for name, (_, seconds) in NETWORKS.items()})
    of_run = table[table.seconds <= budget].groupby(["seed", "network"])[column]
    return of_run.apply(lambda values: values.tail(last).mean()).unstack()


def _in_order(column: pd.Series) -> pd.Series:
    names = list(NETWORKS)
    return column.map(names.index) if column.name == "network" else column


def curves(table: pd.DataFrame) -> Figure:
    """Held-out goal ratio against steps, and against minutes: every run."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(PAGE, 2.4), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for (network, (label, _)), (color, dashes) in zip(NETWORKS.items(), LOOKS, strict=True):
            for number, (_, run) in enumerate(table[table.network == network].groupby("seed")):
                style = {"color": color, "linestyle": dashes, "label": label if number == 0 else None}
                for axes, along in zip(panels, (run.env_steps / 1e6, run.seconds / 60), strict=True):
                    axes.plot(along, run.goal_ratio, **style)
        for axes, name in zip(panels, ("million steps", "minutes of one core"), strict=True):
            axes.set(xlabel=name, ylim=(0, 1), xlim=(0, None))
            axes.set_yticks(np.linspace(0, 1, 6))
            axes.grid()
        panels[0].set_ylabel("goal ratio in plans held out")
        legend_below(figure)
    return figure


def main(words: list[str] | None = None) -> None:
    """Draws it, and prints the ends: of every seed, then the means of what else there is."""
    parser = argparse.ArgumentParser(description="The picture of memory.md.")
    parser.add_argument("--runs", type=Path)
    parser.add_argument("--out", type=Path, default=HERE / "images" / "results")
    given = parser.parse_args(words)
    if given.runs is not None:
        joined(pd.read_csv(TABLE), collect(given.runs)).to_csv(TABLE, index=False)
    table = pd.read_csv(TABLE)
    reached = ends(table)
    print(reached.round(3).to_string())
    for without, remembers in PAIRS:
        difference = (reached[remembers] - reached[without]).dropna()
        low, high = stats.t.interval(0.95, len(difference) - 1, difference.mean(), stats.sem(difference))
        print(f"{remembers} - {without}: {difference.mean():.3f} [{low:.3f}, {high:.3f}]")
    print("million steps", (ends(table, "env_steps", last=1) / 1e6).round(0).to_dict("list"))
    for column in (
        "spl",
        "timeout",
        "collision",
        *(name for name in table if name.startswith("goal_ratio.")),
    ):
        print(column, ends(table, column).mean().round(2).to_dict())
    with matplotlib.rc_context(STYLE):
        curves(table).savefig(given.out / "memory-floorplans.png", dpi=DPI)


if __name__ == "__main__":
    main()
