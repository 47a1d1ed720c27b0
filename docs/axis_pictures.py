"""The picture of spaces.md: success of one policy against every axis, each varied alone.

    pecjax train --task.space rooms-pairs --iterations 732 --out RUN
    python docs/axis_pictures.py RUN --out docs/images/results/axes

Every configuration that the run's space holds out is flown at five values of an axis, while all others are
at their defaults, in still air.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from pecjax.envs.axes import axes_of
from pecjax.envs.rooms.config import Configurations
from pecjax.envs.task import EvalSet, take_configs
from pecjax.plotting.evaluation import evaluation
from pecjax.plotting.style import save, set_title
from pecjax.runtime.devices import keep_compiled_programs, use_all_cores
from pecjax.training.eval_report import make_report
from pecjax.training.load import open_run
from pecjax.training.settings import EvaluationSettings

LEVELS = {
    "wind (m/s)": [0, 2, 4, 6, 8],
    "gust (m/s)": [0, 0.5, 1, 2, 4],
    "payload (kg)": [0, 0.25, 0.5, 1, 2],
    "motor_strength": [0.4, 0.55, 0.7, 0.85, 1],
    "visibility (m)": [0.5, 1, 2, 4, 20],
    "depth_noise": [0, 0.1, 0.2, 0.4, 0.8],
    "depth_dropout": [0, 0.1, 0.2, 0.4, 0.8],
    "latency (control steps)": [0, 1, 2, 4, 8],
    "heading (rad)": [-2.5, -1.25, 0, 1.25, 2.5],
}


def axis_of(name: str) -> str:
    """The axis of a panel, without its unit."""
    return name.partition(" ")[0]


def in_air(table: Configurations) -> Configurations:
    """The same configurations with every axis that is varied, at its default; headings are drawn here."""
    known, number = axes_of(Configurations), table.size
    filled = {}
    for name in map(axis_of, LEVELS):
        about = known[name]
        shape = (number,) if len(about.columns) == 1 else (number, len(about.columns))
        filled[name] = np.full(shape, about.default, about.dtype)
    headings = np.random.default_rng(0).uniform(-np.pi, np.pi, number).astype(np.float32)
    return table.replace(**filled | {"heading": headings})


def varied(table: Configurations, name: str, values: np.ndarray) -> Configurations:
    """The table with other values (N,) of one axis; of wind they are speeds, towards anywhere."""
    axis = axis_of(name)
    if axis == "wind":
        towards = np.random.default_rng(1).uniform(-np.pi, np.pi, len(values))
        values = values[:, None] * np.stack([np.cos(towards), np.sin(towards), 0 * towards], axis=-1)
    return table.replace(**{axis: values.astype(getattr(table, axis).dtype)})


def main(words: list[str] | None = None) -> None:
    """Flies, prints the goal ratios and draws them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, default=Path("axes"))
    given = parser.parse_args(words)
    trained = open_run(given.run)
    held_out = trained.run.eval_set.table
    five = in_air(take_configs(held_out, np.repeat(np.arange(held_out.size), 5)))
    about = EvaluationSettings(episodes=five.size, seed=1)
    trained = trained._replace(settings=dataclasses.replace(trained.settings, evaluation=about))
    trained = trained.elsewhere(trained.run.world, EvalSet(five))
    evaluate, bins = trained.evaluator(), {}
    for name, levels in LEVELS.items():
        values = np.tile(np.asarray(levels, float), held_out.size)
        table = varied(five, name, values)
        result = evaluate(trained.run.eval_world._replace(table=table))
        report: dict[str, Any] = make_report(result, EvalSet(table), {name: values})
        bins |= report["features"]
        print(name, [(part["low"], round(part["goal_ratio"], 3)) for part in report["features"][name]])
    figure = evaluation({"all": report["all"], "groups": {}, "features": bins})
    set_title(figure, f"{held_out.size:,} held-out configurations at each value")
    save(figure, given.out)


if __name__ == "__main__":
    use_all_cores()
    keep_compiled_programs()
    main()
