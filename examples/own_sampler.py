"""A sampler of your own, in a study beside PEC and uniform sampling.

    python examples/own_sampler.py [smoke|laptop]

The same from the command line, in this folder:

    pecjax train --sampler own_sampler:Learnability --sampler.floor 0.1
    pecjax study --samplers own_sampler:Learnability pec uniform
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp

from pecjax.curriculum import Sampler, SamplerSettings, from_counts
from pecjax.runtime.devices import use_all_cores
from pecjax.studies.catalogue import find_study
from pecjax.studies.report import write_report
from pecjax.studies.run import run_study


@dataclass(frozen=True)
class Learnability(SamplerSettings):
    """Draws what fails about half of the time, in proportion to p (1 - p) of the failure ratio p.

    Attributes:
        floor: added to that, so that nothing is forgotten.
    """

    floor: float = 0.05

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""

        def priority(trials: jax.Array, failures: jax.Array, numbers: dict[str, jax.Array]) -> jax.Array:
            p = failures / jnp.maximum(trials, 1)
            return jnp.where(trials > 0, p * (1 - p) + numbers["floor"], 1.0)

        return from_counts(num_configs, {"floor": self.floor}, priority)


def main(scale: str = "smoke", folder: Path = Path("studies")) -> None:
    """Trains each sampler from the same seeds, and prints how they compare."""
    grid = {"sampler": (f"{__name__}:Learnability", "pec", "uniform"), "sampler.alpha": (0.2,)}
    study = find_study("fig4", scale)
    study = replace(study, name="own", grid=tuple(grid.items()), parallel_runs=len(jax.devices()))
    run_study(study, folder / f"own-sampler-{scale}")
    print(write_report(folder / f"own-sampler-{scale}"))


if __name__ == "__main__":
    use_all_cores()
    main(*sys.argv[1:2])
