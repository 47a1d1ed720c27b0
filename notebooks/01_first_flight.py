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
from pecjax.runtime.devices import use_all_cores

use_all_cores()  # before JAX is first used: every core becomes a device

# %%
import time
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import pecjax
from pecjax.envs.task import take_configs
from pecjax.plotting import run as run_figures
from pecjax.plotting.maps import floor_plan
from pecjax.studies.catalogue import find_study
from pecjax.training import train as training
from pecjax.training.load import open_run

# %% [markdown]
# ## The rooms
#
# What is flown is a *configuration*: where to start and where to go. The paper's first set has twenty.

# %%
scene, table = pecjax.load_scene(), pecjax.COORDINATE_SET_1
for start, goal in zip(table.start[:4], table.goal[:4], strict=True):
    print(f"from {start} m to {goal} m")

# %% [markdown]
# ## Train
#
# The configuration of each next episode is drawn with probability proportional to its failure ratio + α.
# Every setting is a field of one frozen dataclass.

# %%
settings = find_study("fig4", SCALE).run
folder = Path("runs") / time.strftime("first-flight-%Y%m%d-%H%M%S")
summary = training.train(settings, folder)
summary

# %% [markdown]
# ## Look

# %%
run_figures.draw_run(folder)
Image(folder / "figures" / "goal_ratio.png", width=600)

# %% [markdown]
# Training ratios are taken over what PEC drew, the hard configurations, with drawn actions: they
# understate the policy. The uniform evaluation is even over the configurations.

# %%
Image(folder / "figures" / "configurations.png", width=1000)

# %%
Image(folder / "figures" / "map.png", width=520)

# %% [markdown]
# ## Fly
#
# The task is a few pure functions for one drone, and so is the policy.

# %%
trained = open_run(folder)
task, world, act = trained.run.task, trained.run.world, jax.jit(trained.policy())
reset, observe, step = jax.jit(task.reset), jax.jit(task.observe), jax.jit(task.step)

config = take_configs(world.table, 18)  # c18, through two doors
key, over = jax.random.key(0), False
state = reset(key, config, world.params)
seen, path = [], []
while not over:
    obs = observe(key, state, world.params)
    seen.append(np.asarray(obs["depth"]) * task.vehicle.camera.far)  # networks are given shares of it
    path.append(np.asarray(state.qpos[:2]))
    after = step(key, state, act(obs, key), world.params)
    state, over = after.state, bool(after.terminated)
print(f"{len(path)} steps, goal reached: {bool(after.success)}")

# %%
figure, axes = plt.subplots(figsize=(5, 5))
floor_plan(axes, scene.map, scene.drone_radius)
axes.plot(*np.array(path).T, color="#1f5f99")
axes.plot(*config.goal, "o", color="#00573f")
plt.show()

# %% [markdown]
# What it saw on the way (distance in metres, nearer is darker):

# %%
figure, panels = plt.subplots(1, 5, figsize=(11, 2))
for axes, time_step in zip(panels, np.linspace(0, len(seen) - 1, 5).astype(int), strict=True):
    axes.imshow(seen[time_step], cmap="gray", vmin=0, vmax=10)
    axes.set(title=f"{time_step * 0.1:.1f} s", xticks=[], yticks=[])
plt.show()
