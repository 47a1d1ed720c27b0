"""Grids: which runs a study is made of, and how they are cut into slices."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import jax

from pecjax import settings_tree
from pecjax.errors import InputError
from pecjax.training.presets import RunSettings, check_settings, override
from pecjax.training.samplers import has_alpha, make_sampler

Values = tuple[tuple[str, Any], ...]  # by dotted path


class RunSpec(NamedTuple):
    """One run of a study.

    Attributes:
        coordinates: the paper's set 1 or 2, or a file.
        sampler: a name that `make_sampler` knows.
        alpha: α where the sampler has one, else None.
        seed: of everything random in training: those with the same seed begin alike.
        values: of other settings that the study varies.
    """

    coordinates: str
    sampler: str
    alpha: float | None
    seed: int
    values: Values = ()


@dataclass(frozen=True)
class StudySettings:
    """A grid of runs that differ in sampler, α, coordinates, seed and `grid`, and in nothing else.

    Attributes:
        name: what the study is called.
        run: what all its runs share; what varies is taken from the fields below.
        samplers, alphas, coordinates, seeds: the grid; each α is tried with each sampler that has one.
        at_once: runs in one program, shared by the devices.
        grid: further settings, of the learner or of samplers, and what each is tried with: dotted path
            and values. Those of a sampler are tried with the samplers that have them.
    """

    name: str
    run: RunSettings
    samplers: tuple[str, ...] = ("pec", "uniform")
    alphas: tuple[float, ...] = (0.2,)
    coordinates: tuple[str, ...] = ("1",)
    seeds: tuple[int, ...] = tuple(range(5))
    at_once: int = 2
    grid: tuple[tuple[str, tuple[Any, ...]], ...] = ()

    def check(self) -> None:
        """Makes sure that every run of the grid can be run.

        Raises:
            InputError: the first thing that cannot.
        """
        axes = {name: getattr(self, name) for name in ("samplers", "alphas", "coordinates", "seeds")}
        for name, values in (*axes.items(), *self.grid):
            if not values:
                raise InputError(f"{name} is empty; give at least one")
            twice = sorted({str(value) for value in values if values.count(value) > 1})
            if twice:
                raise InputError(f"{name} names {', '.join(twice)} more than once; name each once")
        stems = [Path(name).stem for name in self.coordinates]
        if len(set(stems)) < len(stems):
            raise InputError(f"coordinates: {', '.join(self.coordinates)} need names that differ; rename one")
        if self.at_once < 1:
            raise InputError(f"at-once is {self.at_once}; it must be at least 1")
        if self.run.until_goal_ratio is not None:
            raise InputError("until-goal-ratio would end each run at another time; leave it out of a study")
        self._check_grid()
        for sampler in self.samplers:
            check_settings(override(self.run, sampler=sampler))
        for alpha in self.alphas:
            check_settings(override(self.run, sampler="pec", alpha=alpha))
        for seed in self.seeds:
            check_settings(override(self.run, seed=seed))
        for sampler, values in product(self.samplers, self._values()):
            alpha = self.alphas[0] if has_alpha(make_sampler(sampler)) else None
            spec = RunSpec("", sampler, alpha, 0, _that_it_has(sampler, values))
            settings = self.settings_of(spec)
            check_settings(settings)
            settings.learner.check()
            _check_numbers(spec, settings)

    def _check_grid(self) -> None:
        paths = [path for path, _ in self.grid]
        if len(set(paths)) < len(paths):
            raise InputError(f"grid: {', '.join(paths)} name a setting twice; give all its values at once")
        for path in paths:
            if path == "sampler.alpha":
                raise InputError("grid: sampler.alpha has an option of its own; give --alphas")
            if not path.startswith(("sampler.", f"{self.run.algorithm}.")):
                raise InputError(
                    f"grid: {path} is neither of the sampler nor of {self.run.algorithm}; "
                    "all runs of a study share it"
                )
            if path.startswith("sampler.") and not any(_has(name, path) for name in self.samplers):
                raise InputError(f"grid: none of {', '.join(self.samplers)} has {path}; leave it out")

    def settings_of(self, member: RunSpec) -> RunSettings:
        """The settings `pecjax train` would need for that run."""
        settings = override(
            self.run,
            coordinates=member.coordinates,
            sampler=member.sampler,
            alpha=member.alpha,
            seed=member.seed,
        )
        for path, value in member.values:
            settings = settings_tree.set_path(settings, path, value)
        return settings

    def groups(self) -> list[list[RunSpec]]:
        """The runs, those that one program can run together: all alike but for seeds and numbers."""
        found: dict[tuple, list[RunSpec]] = {}
        for coordinates, sampler in product(self.coordinates, self.samplers):
            alphas = self.alphas if has_alpha(make_sampler(sampler)) else (None,)
            grid = dict.fromkeys(_that_it_has(sampler, values) for values in self._values())
            for seed, alpha, values in product(self.seeds, alphas, grid):
                member = RunSpec(coordinates, sampler, alpha, seed, values)
                found.setdefault((coordinates, sampler, fixed(values)), []).append(member)
        return [*found.values()]

    def _values(self) -> Iterator[Values]:
        paths = [path for path, _ in self.grid]
        for values in product(*(values for _, values in self.grid)):
            yield tuple(zip(paths, values, strict=True))

    def slices(self) -> list[tuple[RunSpec, ...]]:
        """The runs in the order they are made: low seeds first, the groups in turn."""
        cut = [
            [tuple(group[first : first + self.at_once]) for first in range(0, len(group), self.at_once)]
            for group in self.groups()
        ]
        return [part for turn in zip_longest(*cut) for part in turn if part is not None]


def numbers(member: RunSpec) -> dict[str, float]:
    """The numbers of a run's sampler that are in its state: runs that differ in them share a program."""
    varied = {} if member.alpha is None else {"alpha": member.alpha}
    return varied | {p.removeprefix("sampler."): value for p, value in member.values if _is_number(p, value)}


def _check_numbers(spec: RunSpec, settings: RunSettings) -> None:
    """Makes sure that the sampler's state has the numbers that a study varies in it."""
    varied, sampler = numbers(spec), settings.sampler.make(1)
    try:
        jax.eval_shape(lambda: sampler.init(**varied))
    except TypeError as error:
        raise InputError(
            f"sampler {spec.sampler}: its init does not take {', '.join(varied)} ({error}); keep the numbers "
            "that a study varies in its state (see `from_counts`)"
        ) from error


def fixed(values: Values) -> Values:
    """The values that need a program of their own."""
    return tuple((path, value) for path, value in values if not _is_number(path, value))


def _is_number(path: str, value: Any) -> bool:
    return path.startswith("sampler.") and isinstance(value, float)


def _has(sampler: str, path: str) -> bool:
    return path.removeprefix("sampler.") in dict(settings_tree.leaves(make_sampler(sampler)))


def _that_it_has(sampler: str, values: Values) -> Values:
    """The values without those of other samplers' settings."""
    return tuple((p, value) for p, value in values if not p.startswith("sampler.") or _has(sampler, p))


def read_grid(run: RunSettings, samplers: tuple[str, ...], words: tuple[str, ...]) -> tuple[str, tuple]:
    """A path and its values, from words as a command line has them.

    Raises:
        InputError: no such setting, or a value that it does not take.
    """
    if len(words) < 2:
        raise InputError(f"grid: '{' '.join(words)}' has no values; give a path and what it is tried with")
    path, *values = (words[0].replace("-", "_"), *words[1:])
    if path.startswith("sampler."):
        name = next((name for name in samplers if _has(name, path)), samplers[0])
        run = dataclasses.replace(run, sampler=make_sampler(name))
    taken = [dict(settings_tree.leaves(settings_tree.set_path(run, path, value)))[path] for value in values]
    return path, tuple(taken)
