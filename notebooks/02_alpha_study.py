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
# # How much does α matter?
#
# The paper's Fig. 11-12, one run each there, several seeds here. `pecjax study fig11` runs the same; a
# study that was started, here or there, resumes where it was, and a finished one is only read.

# %% tags=["parameters"]
SCALE = "laptop"  # some half an hour on two cores; "smoke" takes seconds and learns nothing

# %%
from pecjax.runtime.devices import use_all_cores

use_all_cores()  # before JAX is first used: every core becomes a device

# %%
import dataclasses
from pathlib import Path

import ipywidgets
import jax
import pandas as pd
from IPython.display import Image, display

from pecjax.plotting import study as study_figures
from pecjax.studies import report as study_report
from pecjax.studies.catalogue import find_study
from pecjax.studies.run import run_study
from pecjax.studies.tables import StudyTables, read_study

# %% [markdown]
# ## The grid
#
# Samplers × α × seeds; change any of them for a study of your own (and give it another folder).

# %%
study = dataclasses.replace(find_study("fig11", SCALE), parallel_runs=len(jax.devices()))
alphas = study.values_of("sampler.alpha")
print(f"α in {alphas}, seeds {study.seeds}, {study.run.stop.iterations} iterations each")

# %%
folder = Path("..") / "studies" / f"fig11-{SCALE}"
run_study(study, folder)
print(study_report.write_report(folder))

# %% [markdown]
# ## What came out
#
# One tidy table, a row for every evaluation:

# %%
results = pd.read_csv(folder / "results.csv")
last = results[results.iteration == results.iteration.max()]
last.groupby("alpha")[["goal_ratio", "cvar"]].mean()

# %%
study_figures.draw_study(folder)
Image(folder / "figures" / "alpha.png", width=900)

# %% [markdown]
# ## Choose α and seeds

# %%
tables = read_study(folder)


def show(alphas: tuple[float, ...], seeds: tuple[int, ...]) -> None:
    """The curves of the chosen runs."""
    chosen = (t[t.alpha.isin(alphas) & t.seed.isin(seeds)] for t in tables)
    display(study_figures.goal_ratio(StudyTables(*chosen)))


ipywidgets.interactive(
    show,
    alphas=ipywidgets.SelectMultiple(options=alphas, value=alphas[::2], description="α"),
    seeds=ipywidgets.SelectMultiple(options=study.seeds, value=study.seeds, description="seeds"),
)
# %% [markdown]
# ## Which configurations are drawn
#
# With α = 0 what has never failed is not drawn again; the larger α, the nearer to uniform.

# %%
Image(folder / "figures" / "configurations-pec-0.png", width=1000)

# %%
Image(folder / "figures" / "configurations-pec-0.4.png", width=1000)
