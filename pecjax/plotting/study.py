"""The figures of a study: the paper's, with intervals over seeds, and two that it lacks."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

from matplotlib.figure import Figure

from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.task import TaskSettings
from pecjax.plotting.configurations import configurations
from pecjax.plotting.study_curves import evaluation, exits, goal_ratio, groups, spread
from pecjax.plotting.study_ends import alphas, maps, steps_to_threshold
from pecjax.plotting.style import save, set_title
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.grid import shown_space, space_name
from pecjax.studies.measures import by_run, group_columns
from pecjax.studies.tables import StudyTables, read_study, varied_columns
from pecjax.training.kinds import AGENT_LABELS, kind_name


def draw_study(folder: Path) -> list[Path]:
    """Draws every figure of a study as PDF and PNG, for each set of coordinates, into its `figures` folder.

    Raises:
        InputError: the folder holds no study, or none of its batches is finished.
    """
    directory = StudyDirectory(folder)
    settings = directory.settings()
    everything = read_study(folder)
    tasks = dict.fromkeys(settings.settings_of(spec).task for part in settings.batches() for spec in part)
    spaces: dict[str, TaskSettings] = {}
    for number, task in enumerate(tasks):
        space = space_name(dataclasses.replace(settings.run, task=task))
        spaces.setdefault(space, directory.task(number, task))
    agent = kind_name(settings.run.agent)
    paths = []
    for space, task in spaces.items():
        tables = StudyTables(*(table.loc[table.coordinates == space] for table in everything))
        if tables.results.empty:
            continue
        title = f"{AGENT_LABELS.get(agent, agent)} on {shown_space(space)}"
        for name, figure in _figures(tables, task):
            of = figure.get_suptitle()
            set_title(figure, f"{title}, {of}" if of else title)
            stem = name if len(spaces) == 1 else f"{name}-{Path(space).stem}"
            paths.extend(save(figure, folder / "figures" / stem))
    return paths


def _figures(tables: StudyTables, task: TaskSettings) -> Iterator[tuple[str, Figure]]:
    runs = by_run(tables)
    yield "goal_ratio", goal_ratio(tables)
    yield "evaluation", evaluation(tables.results)
    if of_groups := group_columns(tables.results):
        yield "groups", groups(tables.results, of_groups)
    yield "spread", spread(tables.configurations)
    yield "exit", exits(tables.metrics, runs)
    yield "steps_to_threshold", steps_to_threshold(runs)
    if isinstance(task, Rooms) and tables.configurations.goal_ratio.notna().any():  # not held-out ones
        yield "map", maps(tables, task)
    for condition, rows in tables.configurations.groupby("condition", sort=False):
        stem = f"configurations-{condition.replace(', α = ', '-').replace(', ', '-').replace(' = ', '-')}"
        yield stem, configurations(rows, f"{condition}, all seeds")
    if tables.results.alpha.nunique() > 1 and not varied_columns(tables.results):
        yield "alpha", alphas(runs)
