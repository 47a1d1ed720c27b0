"""The sink that collects what the runs of a batch leave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pecjax.storage.tables import Row
from pecjax.training.measures import unbiased_cvar
from pecjax.training.run_episodes import success_by_config
from pecjax.training.sinks import Sink


class Collected(Sink):
    """Rows and arrays of several runs side by side.

    Attributes:
        names: the runs in words.
        diverged: by place, those whose figures are no longer finite, in words.
    """

    def __init__(self, heads: Sequence[Row], elsewhere: bool = False) -> None:
        """Begins with nothing.

        Args:
            heads: the columns that say which run a row is of.
            elsewhere: whether evaluations are of other configurations than those that are trained in, whose
                goal ratios are then unknown (NaN).
        """
        self._heads, self._elsewhere = heads, elsewhere
        self.names = [", ".join(f"{k} {v}" for k, v in head.items() if v is not None) for head in heads]
        self.diverged: dict[int, str] = {}
        self._tables: dict[str, list[list[Row]]] = {
            name: [[] for _ in heads] for name in ("metrics", "evaluation")
        }
        self._counted: list[tuple[int, list[dict[str, Any]]]] = []
        self._since: list[list[float]] = [[] for _ in heads]  # training goal ratios since the evaluation

    def diverge(self, run: int, iteration: int, names: list[str]) -> str:
        """Leaves a run out from here on; says which, when and where."""
        self.diverged[run] = f"{self.names[run]}: at iteration {iteration} not finite: {', '.join(names)}"
        return self.diverged[run]

    def rows(self, table: str, rows: Sequence[Row]) -> None:
        """Adds a row of each run."""
        for run, row in enumerate(rows):
            if table == "metrics":
                self._since[run].append(row["goal_ratio"])
            else:
                ended = [ratio for ratio in self._since[run] if not np.isnan(ratio)]
                self._since[run].clear()
                row = row | {"training_goal_ratio": float(np.mean(ended)) if ended else float("nan")}
            self._tables[table][run].append(self._heads[run] | row)

    def arrays(self, name: str, iteration: int, arrays: Sequence[dict[str, Any]]) -> None:
        """Keeps counts and the goal ratio of every configuration; rows get their unbiased CVaR."""
        if name == "configurations":
            kept = [{part: of_run[part] for part in ("trials", "failures", "steps")} for of_run in arrays]
            self._counted.append((iteration, kept))
        elif name == "episodes":  # of the same iteration, and of the last row of the evaluations
            for of_run, flown, rows in zip(
                self._counted[-1][1], arrays, self._tables["evaluation"], strict=True
            ):
                among = int(flown["config_id"].max()) + 1
                found = unbiased_cvar(flown["config_id"], flown["success"], among)
                rows[-1]["unbiased_cvar"] = float("nan") if found is None else found
                unknown = np.full(len(of_run["trials"]), np.nan)
                of_run["goal_ratio"] = (
                    unknown
                    if self._elsewhere
                    else success_by_config(flown["config_id"], flown["success"], unknown.size)
                )

    def table(self, name: str) -> list[Row]:
        """The rows of all runs that have not diverged, run by run."""
        return [row for run in self._whole() for row in self._tables[name][run]]

    def configurations(self) -> dict[str, np.ndarray]:
        """Trials, failures, steps and goal ratios (R, V, N) of these runs, and their iterations (V,)."""
        counted = [(iteration, arrays) for iteration, arrays in self._counted if "goal_ratio" in arrays[0]]
        found = {
            name: np.array([[arrays[run][name] for _, arrays in counted] for run in self._whole()])
            for name in ("trials", "failures", "steps", "goal_ratio")
        }
        return {"iteration": np.array([iteration for iteration, _ in counted]), **found}

    def _whole(self) -> list[int]:
        return [run for run in range(len(self._heads)) if run not in self.diverged]
