"""What version 0.1 would have left of a study: other tables, other names of files, settings in one level."""

import json
import shutil

import pandas as pd

from pecjax.studies.directory import StudyDirectory

RUN = {
    "preset": "fast",
    "algorithm": "ppo",
    "ppo": {"num_envs": 8, "num_steps": 32, "num_minibatches": 2, "clip": 0.2, "network": {"hidden": [8]}},
    "apex": {"fragment": 2, "huber": 1.0},
    "resolution": None,
    "scene": None,
    "iterations": 40,
    "until_goal_ratio": None,
    "evaluate_every": 5,
    "evaluation_episodes": 40,
}


def as_version_0_1(folder):
    """Makes a study's folder one of version 0.1."""
    directory = StudyDirectory(folder)
    settings = directory.settings()
    results, counts = [], []
    for path, arrays in directory.configurations(len(settings.batches())):
        rows = pd.read_csv(path / "results.csv", dtype=str)
        flat = {name: arrays[name].reshape(len(rows), -1) for name in ("trials", "failures", "goal_ratio")}
        configs = range(flat["trials"].shape[1])
        ratios = pd.DataFrame(flat["goal_ratio"], columns=[f"c{config}" for config in configs])
        results.append(pd.concat([rows, ratios], axis=1))
        kept = pd.DataFrame({"config": list(configs)}).merge(rows.loc[:, :"iteration"], "cross")
        of_config = {name: flat[name].T.ravel() for name in ("trials", "failures")}
        counts.append(kept[[*rows.loc[:, :"iteration"].columns, "config"]].assign(**of_config))
        (path / "configurations.npz").unlink()
    pd.concat(results).to_csv(folder / "results.csv", index=False)
    pd.concat(counts).to_csv(folder / "configurations.csv", index=False)
    tables = [settings.settings_of(part[0]).task.table for part in settings.batches()]
    for number, table in enumerate(dict.fromkeys(tables)):
        kept = folder / f"task-{number}"
        (kept / "coordinates.csv").rename(folder / f"coordinates-{table}.csv")
        shutil.copy(kept / "scene.xml", folder / "scene.xml")
        shutil.rmtree(kept)
    content = json.loads((folder / "study.json").read_text())
    content["versions"]["pecjax"] = "0.1.0"
    content["settings"] = {
        "name": settings.name,
        "run": RUN | {"sampler": {"kind": "pecjax.curriculum.pec:PEC", "alpha": 0.2}, "coordinates": "1"},
        "samplers": settings.values_of("sampler"),
        "alphas": settings.values_of("sampler.alpha"),
        "coordinates": settings.values_of("task.table"),
        "seeds": settings.seeds,
        "at_once": settings.parallel_runs,
        "grid": [],
    }
    (folder / "study.json").write_text(json.dumps(content))
