"""Grids: which runs a study is made of, and how they are cut into batches."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import jax

from pecjax import settings_tree
from pecjax.envs.task import TaskSettings
from pecjax.errors import InputError
from pecjax.storage.files import exact_text
from pecjax.storage.tables import Row
from pecjax.training.contracts import check_signal
from pecjax.training.kinds import kind_name
from pecjax.training.settings import RunSettings, check_settings, override

Values = tuple[tuple[str, Any], ...]  # by dotted path
# How options and tables name what most studies vary; tables have these columns in any case.
OPTIONS = {"task.table": "coordinates", "sampler": "samplers", "sampler.alpha": "alphas"}
COLUMNS = {"task.table": "coordinates", "sampler": "sampler", "sampler.alpha": "alpha"}


class RunSpec(NamedTuple):
    """One run of a study.

    Attributes:
        seed: of everything random in training: those with the same seed begin alike.
        values: of the grid's settings, those that the run has.
    """

    seed: int
    values: Values = ()


@dataclass(frozen=True)
class StudySettings:
    """A grid of runs that differ in their seed and in some settings, and in nothing else.

    Attributes:
        name: what the study is called.
        run: what all its runs share.
        grid: the settings that it varies, by dotted path, and what each is tried with: `sampler` by
            name, or a leaf of the sampler, the agent or the task. A sampler's own settings are tried
            with the samplers that have them.
        conditions: settings that are tried together, each of them with all of the grid: by the same paths,
            none of which the grid has.
        seeds: each is tried with all of them.
        parallel_runs: runs in one program, shared by the devices.
    """

    name: str
    run: RunSettings
    grid: tuple[tuple[str, tuple[Any, ...]], ...] = (("sampler", ("pec", "uniform")),)
    seeds: tuple[int, ...] = tuple(range(5))
    parallel_runs: int = 2
    conditions: tuple[Values, ...] = ((),)

    def check(self) -> None:
        """Makes sure that every run of the grid can be run.

        Raises:
            InputError: the first thing that cannot.
        """
        for path, values in (("seeds", self.seeds), *self.grid):
            name = OPTIONS.get(path, path)
            if not values:
                raise InputError(f"{name} is empty; give at least one")
            twice = sorted({str(value) for value in values if values.count(value) > 1})
            if twice:
                raise InputError(f"{name} names {', '.join(twice)} more than once; name each once")
        stems = [Path(name).stem for name in self.values_of("task.table")]
        if len(set(stems)) < len(stems):
            raise InputError(f"coordinates: {', '.join(self.values_of('task.table'))} need names that differ")
        if self.parallel_runs < 1:
            raise InputError(f"parallel-runs is {self.parallel_runs}; it must be at least 1")
        if self.run.stop.until_goal_ratio is not None:
            raise InputError("until-goal-ratio would end each run at another time; leave it out of a study")
        self._check_paths()
        for seed in self.seeds:
            check_settings(dataclasses.replace(self.run, seed=seed))
        for values in self._combinations():
            check_settings(self.settings_of(RunSpec(0, values)))

    def check_samplers(self, num_configs: Mapping[TaskSettings, int]) -> None:
        """Makes sure that the sampler of every run can be made, and has the numbers that it varies.

        Args:
            num_configs: of each of the study's tasks.

        Raises:
            InputError: the first that cannot, or lacks one.
        """
        for values in self._combinations():
            spec = RunSpec(0, values)
            settings = self.settings_of(spec)
            _check_sampler(self.numbers([spec]), settings, num_configs[settings.task])

    def _check_paths(self) -> None:
        paths = [path for path, _ in self.grid]
        also = set(paths) & {path for values in self.conditions for path, _ in values}
        if len(set(paths)) < len(paths) or also:
            names = ", ".join(sorted(also) or paths)
            raise InputError(f"grid: {names} name a setting twice; give all its values at once")
        for path in self.paths():
            if path != "sampler" and not path.startswith(("sampler.", "agent.", "task.")):
                raise InputError(
                    f"grid: {path} is not of task, sampler or agent; all runs of a study share it"
                )
            if not any(path in dict(values) for values in self._combinations()):
                names = ", ".join(self.values_of("sampler")) or kind_name(self.run.sampler)
                raise InputError(f"grid: none of {names} has {path}; leave it out")

    def paths(self) -> list[str]:
        """Of the settings that the study varies."""
        of_conditions = [path for values in self.conditions for path, _ in values]
        return list(dict.fromkeys([*(path for path, _ in self.grid), *of_conditions]))

    def values_of(self, path: str) -> tuple[Any, ...]:
        """What a setting is tried with; nothing where the study does not vary it."""
        together = [dict(values)[path] for values in self.conditions if path in dict(values)]
        return (*dict(self.grid).get(path, ()), *dict.fromkeys(together))

    def settings_of(self, spec: RunSpec) -> RunSettings:
        """The settings `pecjax train` would need for that run."""
        values = dict(spec.values)
        settings = override(self.run, sampler=values.pop("sampler", None))
        for path, value in values.items():
            settings = settings_tree.set_path(settings, path, value)
        return dataclasses.replace(settings, seed=spec.seed)

    def numbers(self, specs: Sequence[RunSpec]) -> dict[str, list[float]]:
        """The numbers in the sampler's state that one run varies, by name, as each run has them.

        Runs that differ in them share a program.
        """
        varied = dict.fromkeys(
            path for spec in specs for path, value in spec.values if _is_number(path, value)
        )
        runs = [dict(settings_tree.leaves(self.settings_of(spec))) for spec in specs]
        return {path.removeprefix("sampler."): [run[path] for run in runs] for path in varied}

    def row(self, spec: RunSpec) -> Row:
        """What tables call a run: a column for each setting that the study varies."""
        settings = self.settings_of(spec)
        values = dict(spec.values)
        head: Row = {"study": self.name, "coordinates": space_name(settings)}
        head |= {"sampler": kind_name(settings.sampler), "alpha": getattr(settings.sampler, "alpha", None)}
        head |= {"seed": spec.seed} | {p: values.get(p) for p in self.paths() if p not in COLUMNS}
        return {name: _text(value) for name, value in head.items()}

    def groups(self) -> list[list[RunSpec]]:
        """The runs, those that one program can run together: all alike but for seeds and numbers."""
        found: dict[Values, list[RunSpec]] = {}
        combinations = [*self._combinations()]
        for seed, values in product(self.seeds, combinations):
            found.setdefault(fixed(values), []).append(RunSpec(seed, values))
        return [found[key] for key in dict.fromkeys(map(fixed, combinations))]

    def _combinations(self) -> Iterator[Values]:
        """Every combination of the grid's values, without those that a sampler does not have."""
        paths = [path for path, _ in self.grid]
        found: dict[Values, None] = {}
        for together, values in product(self.conditions, product(*(values for _, values in self.grid))):
            chosen = dict(together) | dict(zip(paths, values, strict=True))
            sampler = override(self.run, sampler=chosen.get("sampler")).sampler
            own = {f"sampler.{path}" for path, _ in settings_tree.leaves(sampler)}
            has = {path: v for path, v in chosen.items() if not path.startswith("sampler.") or path in own}
            found[tuple(has.items())] = None
        yield from found

    def batches(self) -> list[tuple[RunSpec, ...]]:
        """The runs in the order they are made: low seeds first, the groups in turn."""
        size = self.parallel_runs
        cut = [
            [tuple(group[first : first + size]) for first in range(0, len(group), size)]
            for group in self.groups()
        ]
        return [part for turn in zip_longest(*cut) for part in turn if part is not None]


def _text(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return " ".join(map(str, value))
    return exact_text(value) if isinstance(value, float) else value


def space_name(settings: RunSettings) -> str:
    """What tables call the configurations of a run: its space, its task's table, or the task."""
    named = (getattr(settings.task, name, None) for name in ("space", "table_name"))
    return next((str(name) for name in named if name is not None), kind_name(settings.task))


def shown_space(name: str) -> str:
    """The same in words: `set 1`, or a space or a table without folder and ending."""
    return f"set {name}" if name.isdecimal() else Path(name).stem


def fixed(values: Values) -> Values:
    """The values that need a program of their own."""
    return tuple((path, value) for path, value in values if not _is_number(path, value))


def _is_number(path: str, value: Any) -> bool:
    return path.startswith("sampler.") and isinstance(value, float)


def _check_sampler(varied: Mapping[str, Sequence[float]], settings: RunSettings, num_configs: int) -> None:
    """Makes sure that the sampler suits the agent, and that its state has the numbers that a study varies."""
    sampler = settings.sampler.make(num_configs)
    check_signal(settings.agent, sampler)
    try:
        jax.eval_shape(lambda: sampler.init(**{name: values[0] for name, values in varied.items()}))
    except TypeError as error:
        raise InputError(
            f"sampler {kind_name(settings.sampler)}: its init does not take {', '.join(varied)} ({error}); "
            "keep the numbers that a study varies in its state (see `from_counts`)"
        ) from error


def read_grid(run: RunSettings, samplers: tuple[str, ...], words: tuple[str, ...]) -> tuple[str, tuple]:
    """A path and its values, from words as a command line has them.

    Raises:
        InputError: no such setting, or a value that it does not take.
    """
    if len(words) < 2:
        raise InputError(f"grid: '{' '.join(words)}' has no values; give a path and what it is tried with")
    path = words[0].replace("-", "_")
    if path in ("task", "agent"):
        raise InputError(f"grid: all runs of a study share their {path}; give it with --{path}")
    if path == "sampler":
        return path, tuple(kind_name(override(run, sampler=name).sampler) for name in words[1:])
    for name in samplers:  # the first that has it, else the error of the last
        tried = override(run, sampler=name)
        if path in dict(settings_tree.leaves(tried)):
            break
    else:
        tried = override(run, sampler=samplers[0])
    values = [None if word == "none" else word for word in words[1:]]
    taken = [dict(settings_tree.leaves(settings_tree.set_path(tried, path, value)))[path] for value in values]
    return path, tuple(taken)
