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
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

folder = Path("runs") / time.strftime("own-%Y%m%d-%H%M%S")
folder.mkdir(parents=True)
# %cd -q {folder}

# %% [markdown]
# ## A map
#
# A map can be drawn as text: `#` is wall, `.` is free, and the drone flies from every `S` to every `G`.

# %%
plan = """\
// Two rooms and a corridor. A character is a square of one metre.
cell 1
height 2.5

################
#S.....#......G#
#......#.......#
#..............#
#..............#
#......#.......#
#S.....#......G#
#...########...#
#..............#
#S............G#
################
"""
Path("plan.txt").write_text(plan)

# %% [markdown]
# `check` says what it understood, and draws it:

# %% language="bash"
# pecjax check --scene plan.txt

# %%
Image("check.png", width=520)

# %% [markdown]
# A map that needs more than squares is an MJCF file. `pecjax new-map rooms.xml` writes one to be changed.
#
# ## A sampler
#
# A sampler is four pure functions over a state; `from_counts` makes them of a priority. This one draws what
# fails about half of the time, where most may be learned (p (1 - p), as in SFL and ProCuRL). Its settings are
# a class, which commands name by its address.

# %%
# %%writefile mine.py
from dataclasses import dataclass

import jax.numpy as jnp

from pecjax.curriculum import Sampler, SamplerSettings, from_counts


@dataclass(frozen=True)
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
iterations, every = {"laptop": (90, 15), "smoke": (2, 1)}[SCALE]

# %% magic_args="-s {iterations} {every}" language="bash"
# pecjax study --scene plan.txt --samplers mine:Learnability pec uniform --seeds 0-1 \
#   --iterations $1 --evaluate-every $2 --out study 2>&1

# %%
Image("study/figures/map.png", width=1000)

# %%
Image("study/figures/goal_ratio.png", width=800)

# %% [markdown]
# Two seeds show that it works, not which is better; `docs/results.md` has comparisons that say something.
#
# ## PEC in someone else's loop
#
# Nothing of the simulator is needed. Here a "learner" fails at thirty tasks of rising difficulty, and each
# trial makes the task a little easier.

# %%
import jax
import jax.numpy as jnp

from pecjax.curriculum import Outcomes, pec

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
