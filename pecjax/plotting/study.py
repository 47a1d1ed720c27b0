"""The figures of a study: the paper's, with intervals over seeds, and two that it lacks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from matplotlib.figure import Figure

from pecjax.envs.rooms.config import Configurations
from pecjax.envs.rooms.scene import Scene, load_scene
from pecjax.plotting.configurations import configurations
from pecjax.plotting.study_curves import evaluation, exits, goal_ratio, spread
from pecjax.plotting.study_ends import alphas, maps, steps_to_threshold
from pecjax.plotting.style import LEARNERS, save
from pecjax.studies.directory import StudyDirectory
from pecjax.studies.report import StudyTables, by_run, read_study, varied_columns


def draw_study(folder: Path) -> list[Path]:
    """Draws every figure of a study, for each set of coordinates, into its `figures` folder.

    Raises:
        InputError: the folder holds no study, or none of its slices is finished.
    """
    directory = StudyDirectory(folder)
    settings = directory.settings()
    everything = read_study(folder)
    scene = load_scene(directory.scene_path, settings.run.resolution)
    paths = []
    for coordinates in settings.coordinates:
        tables = StudyTables(*(table.loc[table.coordinates == coordinates] for table in everything))
        if tables.results.empty:
            continue
        seeds = tables.results.groupby("condition").seed.nunique()
        number = f"{seeds.max()}" if seeds.min() == seeds.max() else f"{seeds.min()} to {seeds.max()}"
        title = (
            f"{settings.name}: {LEARNERS[settings.run.algorithm]}, coordinates {Path(coordinates).stem}, "
            f"{number} seed{'' if number == '1' else 's'}"
        )
        for name, figure in _figures(tables, scene, directory.table(coordinates)):
            figure.suptitle(title, fontsize=10)
            stem = name if len(settings.coordinates) == 1 else f"{name}-{Path(coordinates).stem}"
            paths.extend(save(figure, folder / "figures" / stem))
    return paths


def _figures(tables: StudyTables, scene: Scene, table: Configurations) -> Iterator[tuple[str, Figure]]:
    runs = by_run(tables)
    yield "goal_ratio", goal_ratio(tables)
    yield "evaluation", evaluation(tables.results)
    yield "spread", spread(tables.configurations)
    yield "exit", exits(tables.metrics, runs)
    yield "steps_to_threshold", steps_to_threshold(runs)
    yield "map", maps(tables.results, scene, table)
    for condition, rows in tables.configurations.groupby("condition", sort=False):
        stem = f"configurations-{condition.replace(', α = ', '-').replace(', ', '-').replace(' = ', '-')}"
        yield stem, configurations(rows, f"{condition}, ", ", all seeds")
    if tables.results.alpha.nunique() > 1 and not varied_columns(tables.results):
        yield "alpha", alphas(runs)
