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
scene = pecjax.load_scene()
for start, goal in list(zip(*pecjax.COORDINATE_SET_1, strict=True))[:4]:
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
# The environment is a Brax `Env` for one drone; the policy takes one observation.

# %%
trained = open_run(folder)
env, act = trained.run.env, jax.jit(trained.policy())
step, reset = jax.jit(env.step), jax.jit(env.reset_to)

config = jax.tree.map(lambda leaf: leaf[18], pecjax.COORDINATE_SET_1)  # c18, through two doors
state = reset(config, jax.random.key(0))
seen, path = [], []
while not state.done:
    seen.append(np.asarray(state.obs["depth"]))
    path.append(np.asarray(state.pipeline_state.qpos[:2]))
    state = step(state, act(state.obs, jax.random.key(1)))
print(f"{len(path)} steps, goal reached: {bool(state.metrics['goal'])}")

# %%
figure, axes = plt.subplots(figsize=(5, 5))
floor_plan(axes, scene)
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
