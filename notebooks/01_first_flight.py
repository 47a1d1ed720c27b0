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
# # First flight
#
# Train a drone to find its way through six rooms, look at what it learned, and fly it.

# %% tags=["parameters"]
SCALE = "laptop"  # two or three minutes on two cores; "smoke" takes seconds and learns nothing

# %%
import time
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import pecjax
from pecjax.envs.task import take_configs

pecjax.use_all_cores()  # before JAX is first used: every core becomes a device

# %% [markdown]
# ## The rooms
#
# What is flown is a *configuration*: where to start and where to go. The paper's first set has twenty.

# %%
table = pecjax.COORDINATE_SET_1
for start, goal in zip(table.start[:4], table.goal[:4], strict=True):
    print(f"from {start} m to {goal} m")

# %% [markdown]
# ## Train
#
# The configuration of each next episode is drawn with probability proportional to its failure ratio + α.
# Every setting has a path; `pecjax train --help` lists them all.

# %%
changes = {
    "laptop": {"stop.iterations": 300, "evaluation.every": 15},
    "smoke": {"stop.iterations": 4, "evaluation.every": 2, "agent.num_envs": 64},
}
settings = pecjax.RunSettings()
for path, value in changes[SCALE].items():
    settings = pecjax.set_path(settings, path, value)

folder = Path("runs") / time.strftime("first-flight-%Y%m%d-%H%M%S")
result = pecjax.train(settings, folder)
result.summary

# %% [markdown]
# ## Look
#
# The same files come from `pecjax train`, and these commands serve both:

# %% magic_args="-s {folder}" language="bash"
# pecjax figures $1

# %%
Image(folder / "figures" / "goal_ratio.png", width=600)

# %% [markdown]
# Training ratios are taken over what PEC drew, the hard configurations, with drawn actions: they
# understate the policy. The uniform evaluation is even over the configurations.

# %%
Image(folder / "figures" / "configurations.png", width=1000)

# %%
Image(folder / "figures" / "map.png", width=520)

# %% [markdown]
# ## Watch
#
# Some flights of the last evaluation, from above, and what one of the drones sees. `pecjax watch` without
# `--gif` writes a page for the browser, in three dimensions.

# %% magic_args="-s {folder}" language="bash"
# pecjax watch $1 --flights 8 --gif $1/flights.gif

# %%
Image(folder / "flights.gif")

# %% [markdown]
# ## Fly
#
# The task is a few pure functions for one drone, and so is the policy.

# %%
trained = result.trained
task, world, act = trained.run.task, trained.run.world, jax.jit(trained.policy())
reset, observe, step = jax.jit(task.reset), jax.jit(task.observe), jax.jit(task.step)

config = take_configs(world.table, 18)  # c18, through two doors
key, over = jax.random.key(0), False
state = reset(key, config, world.params)
seen = []
while not over:
    obs = observe(key, state, world.params)
    seen.append(np.asarray(obs["depth"]) * task.vehicle.camera.far)  # networks are given shares of it
    after = step(key, state, act(obs, key), world.params)
    state, over = after.state, bool(after.terminated)
print(f"{len(seen)} steps, goal reached: {bool(after.success)}")

# %% [markdown]
# What it saw on the way (distance in metres, nearer is darker):

# %%
figure, panels = plt.subplots(1, 5, figsize=(11, 2))
for axes, time_step in zip(panels, np.linspace(0, len(seen) - 1, 5).astype(int), strict=True):
    axes.imshow(seen[time_step], cmap="gray", vmin=0, vmax=10)
    axes.set(title=f"{time_step * 0.1:.1f} s", xticks=[], yticks=[])
plt.show()
