"""The pictures of memory.md, from tables of all evaluations of its runs.

    python docs/memory_pictures.py                      # into docs/images/results; prints how the runs ended
    python docs/memory_pictures.py --runs SPACE FOLDER  # first puts the runs FOLDER/NETWORK-SEED into a table

SPACE and NETWORK are those of `NETWORKS`. A run takes the place of that of the same network and seed.
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
# By the name of their runs' folders: what they are, and seconds that every run has had.
NETWORKS = {
    "floorplans": {
        "mlp": ("no memory", 540),
        "mingru": ("minGRU", 540),
        "mlp-falling": ("no memory, falling rate", 900),
        "mingru-falling": ("minGRU, falling rate", 900),
        "mlp-25": ("no memory, falling rate, 25 minutes", 1500),
        "mingru-25": ("minGRU, falling rate, 25 minutes", 1500),
        "stack-falling": ("stack, falling rate", 900),
        "mingru-far": ("minGRU, falling rate, discount 0.998, sequences of 128", 900),
        "mlp-paths": ("no memory, falling rate, critic told of paths", 900),
        "mingru-paths": ("minGRU, falling rate, critic told of paths", 900),
        "mlp-predicts": ("no memory, falling rate, told of paths, predicts them", 900),
        "mingru-predicts": ("minGRU, falling rate, told of paths, predicts them", 900),
        "above": ("shown the map", 540),
        "guided": ("shown the way", 540),
    },
    "pairs": {
        "mlp": ("no memory", 120),
        "gru": ("GRU", 120),
        "mingru": ("minGRU", 120),
        "stack": ("stack", 120),
        "guided": ("shown the way", 120),
    },
}
PAIRS = (
    ("mlp", "mingru"),
    ("mlp-falling", "mingru-falling"),
    ("mlp-falling", "mingru-far"),
    ("mlp-falling", "stack-falling"),
    ("mlp-paths", "mingru-paths"),
    ("mlp-falling", "mlp-paths"),
    ("mingru-falling", "mingru-paths"),
    ("mingru-falling", "mingru-predicts"),
    ("mlp-falling", "mingru-predicts"),
    ("mlp-predicts", "mingru-predicts"),
)
# Of those that are drawn; the others are in the page's table.
LOOKS = {
    "floorplans": {
        "mlp-falling": (RED, "-"),
        "mingru-falling": (BLUE, "-"),
        "stack-falling": (TEAL, ":"),
        "mlp-paths": (RED, "--"),
        "mingru-paths": (BLUE, "--"),
        "mlp-predicts": (RED, ":"),
        "mingru-predicts": (BLUE, ":"),
        "above": (YELLOW, "-"),
        "guided": (TEAL, "-"),
    },
    "pairs": {
        "mlp": (RED, "-"),
        "gru": (BLUE, "--"),
        "mingru": (BLUE, "-"),
        "stack": (TEAL, ":"),
        "guided": (TEAL, "-"),
    },
}
DPI = 200


def stored(space: str) -> Path:
    """The table of a space's evaluations."""
    return HERE / "results" / f"memory-{space}.csv"


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


def joined(space: str, table: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """The table with new runs, in the order of `NETWORKS`."""
    run, names = ["network", "seed"], [*NETWORKS[space]]
    kept = table[~table.set_index(run).index.isin(new.set_index(run).index)]

    def in_order(column: pd.Series) -> pd.Series:
        return column.map(names.index) if column.name == "network" else column

    return pd.concat([kept, new]).sort_values([*run, "iteration"], key=in_order, ignore_index=True)


def ends(space: str, table: pd.DataFrame, column: str = "goal_ratio", last: int = 3) -> pd.DataFrame:
    """The mean of each run's last evaluations within the budget, a row a seed and a column a network."""
    budget = table.network.map({name: seconds for name, (_, seconds) in NETWORKS[space].items()})
    of_run = table[table.seconds <= budget].groupby(["seed", "network"])[column]
    return of_run.apply(lambda values: values.tail(last).mean()).unstack()


def curves(space: str, table: pd.DataFrame) -> Figure:
    """Held-out goal ratio against steps, and against minutes: every run of the networks in `LOOKS`."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(PAGE, 2.4), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for network, (color, dashes) in LOOKS[space].items():
            label = NETWORKS[space][network][0]
            for number, (_, run) in enumerate(table[table.network == network].groupby("seed")):
                style = {"color": color, "linestyle": dashes, "label": label if number == 0 else None}
                for axes, along in zip(panels, (run.env_steps / 1e6, run.seconds / 60), strict=True):
                    axes.plot(along, run.goal_ratio, **style)
        for axes, name in zip(panels, ("million steps", "minutes of one core"), strict=True):
            axes.set(xlabel=name, ylim=(0, 1), xlim=(0, None))
            axes.set_yticks(np.linspace(0, 1, 6))
            axes.grid()
        panels[0].set_ylabel("goal ratio, held out")
        legend_below(figure)
    return figure


def tell(space: str, table: pd.DataFrame) -> None:
    """Prints the ends: of every seed, then pairs' differences, then the means of what else there is."""
    reached = ends(space, table)
    print(space, reached.round(3).to_string(), sep="\n")
    for without, remembers in PAIRS:
        if not {without, remembers} <= set(reached):
            continue
        difference = (reached[remembers] - reached[without]).dropna()
        told = "one seed"
        if len(difference) > 1:
            ends_of = stats.t.interval(0.95, len(difference) - 1, difference.mean(), stats.sem(difference))
            told = "[{:.3f}, {:.3f}]".format(*ends_of)
        print(f"{remembers} - {without}: {difference.mean():.3f}, {told}")
    steps = ends(space, table, "env_steps", last=1) / 1e6
    print("million steps", steps.round(1).to_dict("list"))
    groups = (name for name in table if name.startswith("goal_ratio."))
    for column in ("spl", "timeout", "collision", *groups):
        print(column, ends(space, table, column).mean().round(2).to_dict())


def main(words: list[str] | None = None) -> None:
    """Draws both, and prints how they end."""
    parser = argparse.ArgumentParser(description="The pictures of memory.md.")
    parser.add_argument("--runs", nargs=2, metavar=("SPACE", "FOLDER"))
    parser.add_argument("--out", type=Path, default=HERE / "images" / "results")
    given = parser.parse_args(words)
    if given.runs is not None:
        space, new = given.runs[0], collect(Path(given.runs[1]))
        table = joined(space, pd.read_csv(stored(space)), new) if stored(space).is_file() else new
        table.to_csv(stored(space), index=False)
    for space in NETWORKS:
        table = pd.read_csv(stored(space))
        tell(space, table)
        with matplotlib.rc_context(STYLE):
            curves(space, table).savefig(given.out / f"memory-{space}.png", dpi=DPI)


if __name__ == "__main__":
    main()
