# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Your own map, your own sampler, your own loop

# %% tags=["parameters"]
SCALE = "laptop"  # some five minutes on two cores; "smoke" takes seconds and learns nothing

# %%
from pecjax.runtime.devices import use_all_cores

use_all_cores()  # before JAX is first used: every core becomes a device

# %%
import dataclasses
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

from pecjax.curriculum import Outcomes, Sampler, SamplerSettings, from_counts, pec
from pecjax.envs.rooms import load_coordinates, load_scene
from pecjax.envs.rooms.scene import default_scene_path
from pecjax.envs.rooms.validity import check_coordinates
from pecjax.plotting import study as study_figures
from pecjax.studies import report as study_report
from pecjax.studies.catalogue import find_study
from pecjax.studies.run import run_study
from pecjax.training.settings import override

# %% [markdown]
# ## A new map
#
# A map is an MJCF file: every box that does not move is a wall, hit and seen. Here one more wall stands in
# the hall. Coordinates are lines of `x, y, x, y`; both are checked before anything is trained.

# %%
folder = Path("runs") / time.strftime("own-%Y%m%d-%H%M%S")
folder.mkdir(parents=True)
wall = '<geom name="mine" type="box" pos="0.5 -2.2 1.25" size="0.1 1.2 1.25"/>\n    <body name="drone"'
(folder / "map.xml").write_text(default_scene_path().read_text().replace('<body name="drone"', wall))
(folder / "pairs.csv").write_text("-1, -2, 5, -2\n5, -2, -1, -2\n0, 5, 5, 5\n-5, 0, -5, 5\n0, -2, 3, 2\n")

scene, pairs = load_scene(folder / "map.xml"), load_coordinates(str(folder / "pairs.csv"))
check_coordinates(scene, pairs, flight_height=1.2)
print(f"{len(scene.map.names)} walls, {pairs.size} configurations, all can be flown")

# %% [markdown]
# ## A new sampler
#
# A sampler is four pure functions over a state; `from_counts` makes them of a priority. This one draws what
# fails about half of the time, where most may be learned (p (1 - p), as in SFL and ProCuRL). Its settings are
# a class, which a run names by its address: `my.module:Learnability` if it lay in a file.


# %%
@dataclasses.dataclass(frozen=True)
class Learnability(SamplerSettings):
    """Draws in proportion to p (1 - p) of the failure ratio p, and a little more."""

    floor: float = 0.05

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""

        def priority(trials, failures, numbers):
            p = failures / jnp.maximum(trials, 1)
            return jnp.where(trials > 0, p * (1 - p) + numbers["floor"], 1.0)

        return from_counts(num_configs, {"floor": self.floor}, priority)


# %% [markdown]
# Beside PEC and uniform sampling, paired by seed, in the new map:

# %%
study = find_study("fig4", SCALE)
grid = {
    "task.table": (str(folder / "pairs.csv"),),
    "sampler": (f"{__name__}:Learnability", "pec", "uniform"),
    "sampler.alpha": (0.2,),
}
study = dataclasses.replace(
    study,
    name="own",
    run=override(study.run, scene=(str(folder / "map.xml"),), iterations=min(study.run.stop.iterations, 90)),
    grid=tuple(grid.items()),
    seeds=(0, 1),
    parallel_runs=len(jax.devices()),
)
run_study(study, folder / "study")
print(study_report.write_report(folder / "study"))

# %%
study_figures.draw_study(folder / "study")
Image(folder / "study" / "figures" / "map.png", width=1000)

# %%
Image(folder / "study" / "figures" / "goal_ratio.png", width=800)

# %% [markdown]
# Two seeds show that it works, not which is better; `docs/results.md` has comparisons that say something.
#
# ## PEC in someone else's loop
#
# Nothing of the simulator is needed. Here a "learner" fails at thirty tasks of rising difficulty, and each
# trial makes the task a little easier.

# %%
NUM_TASKS, BATCH = 30, 64
sampler = pec(NUM_TASKS, alpha=0.2)


@jax.jit
def train(key: jax.Array):
    """200 batches; returns the probabilities of each."""

    def batch(carry, key):
        state, skill = carry
        key_draw, key_fail = jax.random.split(key)
        ids = sampler.sample(state, key_draw, (BATCH,))
        failed = jax.random.uniform(key_fail, (BATCH,)) > skill[ids]
        state = sampler.update(state, Outcomes(ids, jnp.ones(BATCH, bool), failed))
        skill = jnp.minimum(skill.at[ids].add(0.003), 0.98)
        return (state, skill), (sampler.probabilities(state), skill)

    begin = (sampler.init(), jnp.linspace(0.9, 0.1, NUM_TASKS))
    return jax.lax.scan(batch, begin, jax.random.split(key, 200))[1]


probabilities, skill = train(jax.random.key(0))

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
for axes, values, label in (
    (left, probabilities, "probability"),
    (right, skill, "success rate"),
):
    for batch in (0, 20, 199):
        axes.plot(np.asarray(values[batch]), label=f"batch {batch + 1}")
    axes.set(xlabel="task, by difficulty", ylabel=label)
left.legend()
plt.show()
