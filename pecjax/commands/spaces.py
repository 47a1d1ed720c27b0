"""`pecjax spaces`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from pecjax.commands.drawing import draw_space
from pecjax.commands.options import Option
from pecjax.envs.axes import to_columns
from pecjax.envs.rooms.spaces.catalogue import RECIPES, make_space
from pecjax.envs.rooms.spaces.features import features
from pecjax.envs.rooms.spaces.space import SPLITS, Space
from pecjax.envs.rooms.spaces.space_file import read_space, space_path
from pecjax.errors import InputError


@dataclass(frozen=True)
class Spaces:
    """Lists the named spaces; with a name, describes one, checks it or draws it.

    A space is made from a fixed seed when it is first asked for, and kept in the user's cache folder.
    Train in one with `pecjax train --task.space NAME`.

    Attributes:
        name: of a space, or the file of one. (default: all are listed)
        check: makes it anew and compares, and that nothing held out is trained in.
        out: where a figure of it goes, as .pdf and .png. (default: none is drawn)
    """

    name: tyro.conf.Positional[Option[str]] = None
    check: bool = False
    out: Option[Path] = None

    def run(self) -> None:
        """Lists, or describes one."""
        if self.name is None:
            if self.check or self.out is not None:
                raise InputError("--check and --out are of one space; give its name")
            for name, recipe in RECIPES.items():
                print(f"{name:16} {recipe.version}  {recipe.about}")
            return
        space = read_space(space_path(self.name))
        _describe(space)
        if self.check:
            _check(space)
            print("made anew it is the same, and nothing held out is trained in")
        if self.out is not None:
            print(f"drawn to {' and '.join(map(str, draw_space(space, self.out)))}")


def _check(space: Space) -> None:
    """Makes sure that a space is what its recipe makes today; `read_space` has checked the rest."""
    again = make_space(space.name)
    if again.version != space.version:
        raise InputError(
            f"space {space.name}: version {space.version}, and this version of pecjax makes {again.version}; "
            "runs of one are not to be compared with runs of the other"
        )


def _describe(space: Space) -> None:
    print(f"{space.name} {space.version}: {space.about}")
    if space.maps is None:
        print("  maps: the paper's six rooms")
    else:
        print(f"  maps: {len(space.maps.lower):,} of up to {space.maps.lower.shape[1]} boxes")
    for split in SPLITS:
        part = space.part(split)
        shares = [f"{(part.group == n).sum():,} {name}" for n, name in enumerate(space.groups)]
        of = f" ({', '.join(shares)})" if len(shares) > 1 else ""
        print(f"  {split}: {part.table.size:,} configurations{of}")
        for name, values in features(part.table, part.shortest).items():
            low, middle, high = np.quantile(values, (0, 0.5, 1))
            print(f"    {name:28} median {middle:.3g}, {low:.3g} to {high:.3g}")
    print(f"  columns: {', '.join(to_columns(space.train.table))}")
