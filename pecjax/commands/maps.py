"""`pecjax maps`: makes, checks, lists, draws and exports floor plans."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import numpy as np
import tyro

from pecjax.commands.drawing import draw_plans
from pecjax.commands.options import Option, Strings
from pecjax.envs.rooms.plans.check import check_plans
from pecjax.envs.rooms.plans.export import plan_mjcf
from pecjax.envs.rooms.plans.families import FAMILIES, find_families
from pecjax.envs.rooms.plans.generate import make_plans
from pecjax.envs.rooms.plans.plan_file import read_plans, write_plans
from pecjax.errors import InputError
from pecjax.runtime.devices import num_cores
from pecjax.storage.files import replace_file, writing


@dataclass(frozen=True)
class Make:
    """Makes floor plans from a seed; the same seed gives the same file.

    Attributes:
        number: of plans, which the families take in turn.
        seed: of all that is drawn; another one gives other plans.
        families: names, easy ones first; one that stands twice is dealt twice. (default: all)
        out: the file.
        workers: processes. (default: one a core)
    """

    number: int = 1000
    seed: int = 0
    families: Strings = None
    out: Path = Path("plans.npz")
    workers: Option[int] = None

    def run(self) -> None:
        """Makes and writes them."""
        families = FAMILIES if self.families is None else find_families(self.families)
        plans = make_plans(self.number, self.seed, families, _workers(self.workers))
        write_plans(self.out, plans)
        print(f"{plans.size} plans of {', '.join(plans.names)} in {self.out}")


@dataclass(frozen=True)
class Check:
    """Checks that every plan is closed, that its flight can be flown, and that its measures are right.

    Attributes:
        plans: the file.
        workers: processes. (default: one a core)
    """

    plans: tyro.conf.Positional[Path]
    workers: Option[int] = None

    def run(self) -> None:
        """Checks them all."""
        plans, workers = read_plans(self.plans), _workers(self.workers)
        try:
            check_plans(plans, workers)
        except InputError as error:
            raise InputError(f"{self.plans}: {error}") from None
        print(f"{plans.size} plans: every one is closed, its flight can be flown and its measures are right")


@dataclass(frozen=True)
class List:
    """Lists the families: median and range of the measures of their plans.

    Attributes:
        plans: the file.
    """

    plans: tyro.conf.Positional[Path]

    def run(self) -> None:
        """Prints a line for each family."""
        plans = read_plans(self.plans)
        lines = [["family", "plans", "geodesic (m)", "detour", "narrowest (m)", "doors"]]
        for family, name in enumerate(plans.names):
            some = plans.some(np.flatnonzero(plans.family == family))
            if some.size:
                measures = ((some.geodesic, 1), (some.detour, 2), (some.narrowest, 2), (some.doors, 0))
                lines.append([name, str(some.size), *(_spread(*measure) for measure in measures)])
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        for line in lines:
            print("  ".join(f"{word:<{width}}" for word, width in zip(line, widths, strict=True)).rstrip())


@dataclass(frozen=True)
class Draw:
    """Draws some plans of each family on one page.

    Attributes:
        plans: the file.
        per_family: how many of each family.
        out: where the picture goes, as .pdf and .png.
    """

    plans: tyro.conf.Positional[Path]
    per_family: int = 4
    out: Path = Path("plans")

    def run(self) -> None:
        """Draws and names the files."""
        if not 1 <= self.per_family <= 20:
            raise InputError(f"per-family is {self.per_family}; 1 to 20 can be drawn")
        for path in draw_plans(read_plans(self.plans), self.per_family, self.out):
            print(path)


@dataclass(frozen=True)
class Export:
    """Writes one plan as MJCF, for `--scene` and for MuJoCo's viewer.

    Attributes:
        plans: the file.
        map: number of the plan, from 0 on.
        out: the MJCF file. (default: plan_NUMBER.xml)
        scene: the MJCF file whose drone it gets. (default: the paper's six rooms)
    """

    plans: tyro.conf.Positional[Path]
    map: int = 0
    out: Option[Path] = None
    scene: Option[Path] = None

    def run(self) -> None:
        """Writes and names the file, with its flight as a line of coordinates."""
        plans = read_plans(self.plans)
        text = plan_mjcf(plans, self.map, self.scene)
        out = Path(f"plan_{self.map}.xml") if self.out is None else self.out
        with writing(out, "give another file with --out"):
            out.parent.mkdir(parents=True, exist_ok=True)
            replace_file(out, text)
        ends = np.concatenate([plans.start[self.map], plans.goal[self.map]])
        print(f"{out}; its flight: {', '.join(f'{place:g}' for place in ends)}")


Action = (
    Annotated[Make, tyro.conf.subcommand("make")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[List, tyro.conf.subcommand("list")]
    | Annotated[Draw, tyro.conf.subcommand("draw")]
    | Annotated[Export, tyro.conf.subcommand("export")]
)
ACTIONS = {about.name: kind for kind, about in map(get_args, get_args(Action))}


@dataclass(frozen=True)
class Maps:
    """Makes, checks, lists, draws and exports floor plans by the thousand."""

    action: tyro.conf.OmitArgPrefixes[tyro.conf.OmitSubcommandPrefixes[Action]]

    def run(self) -> None:
        """Does what was asked for."""
        self.action.run()


def _workers(given: int | None) -> int:
    if given is not None and given < 1:
        raise InputError(f"workers is {given}; give at least 1")
    return num_cores() if given is None else given


def _spread(values: np.ndarray, digits: int) -> str:
    """Median and range."""
    middle = np.median(values)
    return (
        f"{middle:.{max(digits, int(middle % 1 > 0))}f} ({values.min():.{digits}f}-{values.max():.{digits}f})"
    )
