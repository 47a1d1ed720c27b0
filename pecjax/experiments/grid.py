"""Grids: which runs a study is made of, and how they are cut into slices."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

from pecjax.errors import InputError
from pecjax.experiments.presets import RunSettings, check_settings, has_alpha


class Member(NamedTuple):
    """One run of a study.

    Attributes:
        coordinates: the paper's set 1 or 2, or a file.
        sampler: a name in `SAMPLERS`.
        alpha: α where the sampler has one, else None.
        seed: of everything random in training: those with the same seed begin alike.
    """

    coordinates: str
    sampler: str
    alpha: float | None
    seed: int


@dataclass(frozen=True)
class StudySettings:
    """A grid of runs that differ in sampler, α, coordinates and seed, and in nothing else.

    Attributes:
        name: what the study is called.
        run: what all its runs share; what varies is taken from the fields below.
        samplers, alphas, coordinates, seeds: the grid; each α is tried with each sampler that has one.
        at_once: runs in one program, shared by the devices.
    """

    name: str
    run: RunSettings
    samplers: tuple[str, ...] = ("pec", "uniform")
    alphas: tuple[float, ...] = (0.2,)
    coordinates: tuple[str, ...] = ("1",)
    seeds: tuple[int, ...] = tuple(range(5))
    at_once: int = 2

    def check(self) -> None:
        """Makes sure that every run of the grid can be run.

        Raises:
            InputError: the first thing that cannot.
        """
        for name in ("samplers", "alphas", "coordinates", "seeds"):
            values = getattr(self, name)
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
        for sampler in self.samplers:
            check_settings(dataclasses.replace(self.run, sampler=sampler))
        for alpha in self.alphas:
            check_settings(dataclasses.replace(self.run, sampler="pec", alpha=alpha))
        for seed in self.seeds:
            check_settings(dataclasses.replace(self.run, seed=seed))

    def settings_of(self, member: Member) -> RunSettings:
        """The settings `pecjax train` would need for that run."""
        alpha = self.run.alpha if member.alpha is None else member.alpha
        return dataclasses.replace(self.run, **member._asdict() | {"alpha": alpha})

    def groups(self) -> list[list[Member]]:
        """The runs, those that one program can run together: same coordinates, same sampler."""
        return [
            [
                Member(coordinates, sampler, alpha, seed)
                for seed in self.seeds
                for alpha in (self.alphas if has_alpha(sampler) else (None,))
            ]
            for coordinates in self.coordinates
            for sampler in self.samplers
        ]

    def slices(self) -> list[tuple[Member, ...]]:
        """The runs in the order they are made: low seeds first, the groups in turn."""
        cut = [
            [tuple(group[first : first + self.at_once]) for first in range(0, len(group), self.at_once)]
            for group in self.groups()
        ]
        return [part for turn in zip_longest(*cut) for part in turn if part is not None]
