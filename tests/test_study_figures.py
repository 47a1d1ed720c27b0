"""Figures of studies, by what is drawn: points at their numbers, and nothing at a number it has not."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from synthetic import BATCH, study_settings, write_study

from pecjax.plotting import seeds, study_curves, study_ends, style
from pecjax.plotting.style import steps_axis
from pecjax.studies import measures, statistics
from pecjax.studies.tables import read_study

INF = np.inf


def made_runs(**steps):
    """A row a run: the steps until 0.9 of each condition, seed by seed; 0.95 takes half as long again."""
    rows = [
        {"condition": condition, "seed": seed, "steps_to_0.9": at, "steps_to_0.95": 1.5 * at}
        for condition, values in steps.items()
        for seed, at in enumerate(values)
    ]
    return pd.DataFrame(rows)


def drawn_points(axes):
    """(K, 2) the marks of all conditions, in data coordinates."""
    return np.concatenate([np.ma.filled(marks.get_offsets(), np.nan) for marks in axes.collections])


def medians(axes):
    return [line.get_ydata()[0] for line in axes.lines if line.get_color() == style.BLACK]


def zones(figure, axes):
    """The shaded zones, (low, high) in data coordinates."""
    figure.draw_without_rendering()
    boxes = [patch.get_window_extent() for patch in axes.patches]
    return [tuple(axes.transData.inverted().transform(box)[:, 1]) for box in boxes]


def numbered_ticks(axes):
    """The ticks in sight that have a number; that of the zone has words."""
    low, high = axes.get_ylim()
    words = [label.get_text() for label in axes.figure.axes[0].get_yticklabels()]
    ticks = zip(axes.get_yticks(), words, strict=True)
    return [tick for tick, word in ticks if low <= tick <= high and "reached" not in word]


@pytest.mark.parametrize("scale", [1e6, 1e4, 100.0])
def test_all_runs_held_and_stand_at_their_steps(scale):
    runs = made_runs(a=[1 * scale, 2 * scale, 4 * scale], b=[3 * scale, 3 * scale, 5 * scale])
    figure = study_ends.steps_to_threshold(runs)
    for axes, longer in zip(figure.axes, (1, 1.5), strict=True):
        unit = {"(millions)": 1e6, "(thousands)": 1e3}.get(figure.axes[0].get_ylabel().rpartition(" ")[2], 1)
        numbers = longer * scale / unit * np.array([1, 2, 4, 3, 3, 5])
        np.testing.assert_allclose(drawn_points(axes)[:, 1], numbers)
        assert numbers.max() < axes.get_ylim()[1]
        np.testing.assert_allclose(medians(axes), longer * scale / unit * np.array([2, 3]))
        assert not axes.patches and not [text for text in axes.texts if "not" in text.get_text()]


def test_runs_that_never_held_lie_in_a_zone_beyond_the_axis():
    runs = made_runs(a=[1e6, 2e6, INF], b=[INF, INF, 3e6], c=[2e6, INF], d=[INF, INF, INF])
    figure = study_ends.steps_to_threshold(runs)
    for axes, longer in zip(figure.axes, (1, 1.5), strict=True):
        ((low, high),) = zones(figure, axes)
        points = drawn_points(axes)
        shown = [points[points[:, 0] == place, 1] for place in range(4)]
        held = np.array([1, 2, 3, 2]) * longer
        numbers = np.concatenate(shown)[[0, 1, 5, 6]]
        np.testing.assert_allclose(numbers, held)
        never = [y for y in points[np.isfinite(points[:, 1]), 1] if not np.isclose(y, held[:, None]).any()]
        assert len(never) == 1 + 2 + 1 + 3 and all(low < y < high for y in never)
        assert numbered_ticks(axes) and max(numbered_ticks(axes)) <= low  # no number within the zone
        assert max(held) < low
        assert medians(axes) == [2 * longer]  # of b, c and d the median run never held it
        assert [text.get_text() for text in axes.texts] == [
            "1 of 3",
            "2 of 3",
            "1 of 2",
            "3 of 3",
        ]
        assert figure.axes[0].get_yticklabels()[-1].get_text() == "Not\nreached"
        assert axes.spines["left"].get_bounds() == (0, pytest.approx(low))


def test_where_no_run_held_no_scale_is_made_up():
    figure = study_ends.steps_to_threshold(made_runs(a=[INF, INF], b=[INF, INF]))
    for axes in figure.axes:
        ((low, high),) = zones(figure, axes)
        points = drawn_points(axes)
        assert len(points) == 4 and (low < points[:, 1]).all() and (points[:, 1] < high).all()
        assert numbered_ticks(axes) == [] and medians(axes) == []
        assert axes.get_ylabel() in ("Environment steps", ""), "without a unit"


def test_a_threshold_that_no_run_held_beside_one_that_some_did():
    runs = made_runs(a=[1e6, 2e6], b=[1e6, 1e6])
    figure = study_ends.steps_to_threshold(runs.assign(**{"steps_to_0.95": INF}))
    left, right = figure.axes
    np.testing.assert_allclose(drawn_points(left)[:, 1], [1, 2, 1, 1])
    for axes in (left, right):
        ((low, _),) = zones(figure, axes)
        assert low > 2 and max(numbered_ticks(axes)) <= low
    assert (drawn_points(right)[:, 1] > low).all() and not medians(right)


def test_a_run_that_is_not_there_is_not_drawn():
    runs = made_runs(a=[1e6, 2e6, 3e6], b=[INF])
    axes = study_ends.steps_to_threshold(runs).axes[0]
    points = drawn_points(axes)
    assert np.isfinite(points[:, 1]).sum() == 4
    assert [text.get_text() for text in axes.texts] == ["1 of 1"]


def test_exits_are_drawn_of_runs_that_had_one():
    iterations = np.arange(1, 41)
    metrics = pd.concat(
        [
            pd.DataFrame(
                {"iteration": iterations, "env_steps": iterations * BATCH, "goal_ratio": iterations / 40}
            ).assign(condition=condition, seed=seed)
            for condition in ("a", "b")
            for seed in (0, 1)
        ]
    )
    runs = pd.DataFrame(
        {
            "condition": ["a", "a", "b", "b"],
            "seed": [0, 1, 0, 1],
            "exit_at_0.9": np.array([30, INF, INF, INF]) * BATCH,
            "exit_at_0.95": np.array([38, INF, INF, INF]) * BATCH,
        }
    )
    figure = study_curves.exits(metrics, runs)
    (axes,) = figure.axes
    marks = [m for m in axes.collections if len(m.get_offsets()) and m.get_sizes().size]
    at = np.concatenate([np.ma.filled(m.get_offsets(), np.nan) for m in marks])
    np.testing.assert_allclose(sorted(at[np.isfinite(at[:, 0]), 0]), [30, 38])
    assert axes.get_xlim()[1] < 60
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["a: exit in 1 and 1 of 2 runs", "b: exit in 0 and 0 of 2 runs"]


@pytest.fixture(scope="module", params=[0.0, 1.0])
def all_alike(request, tmp_path_factory):
    """A study whose runs all fail, and one whose runs all succeed."""
    folder = tmp_path_factory.mktemp("alike") / "study"
    write_study(folder, study_settings((0.0, 0.2)), lambda run, progress: request.param)
    return read_study(folder)


def test_axes_of_ratios_show_ratios(all_alike):
    runs = measures.by_run(all_alike)
    for axes in study_ends.alphas(runs).axes:
        low, high = axes.get_ylim()
        assert -0.05 <= low <= 0 and 0.1 <= high <= 1.05
    for axes in study_curves.evaluation(all_alike.results).axes[:2]:
        low, high = axes.get_ylim()
        assert low < 0 and high > 1  # marks at 0 and 1 are whole


def test_legends_say_what_bands_and_bars_are(all_alike):
    runs = measures.by_run(all_alike)
    figures = [
        study_curves.goal_ratio(all_alike),
        study_curves.evaluation(all_alike.results),
        study_curves.spread(all_alike.configurations),
        study_curves.exits(all_alike.metrics, runs),
        study_ends.alphas(runs),
    ]
    for figure in figures:
        own = [axes.get_legend() for axes in figure.axes]
        legends = [legend for legend in (*own, *figure.legends) if legend is not None]
        assert legends
        words = " ".join(legend.get_title().get_text() for legend in legends)
        assert "Interquartile mean and range, n = 3 seeds" in words


def seeds_of(number):
    rows = [{"condition": c, "seed": s, "value": s * s} for c in "ab" for s in range(number)]
    return pd.DataFrame(rows)


@pytest.mark.parametrize(("number", "words"), [(1, "One seed"), (4, "range, n = 4"), (5, "95 % bootstrap")])
def test_few_seeds_have_a_range_and_more_an_interval(number, words):
    table = seeds_of(number)
    values = table.value.to_numpy(float)[:number]
    found = seeds.band_of(table, values)
    assert words in seeds.how_it_spreads(table)
    if number < seeds.ENOUGH:
        assert (found.low, found.high) == (values.min(), values.max())
    else:
        assert values.min() <= found.low < found.value < found.high <= values.max()
        assert found == statistics.interval(values)


def test_a_condition_with_fewer_seeds_is_said():
    table = seeds_of(7).iloc[:-1]
    assert seeds.how_it_spreads(table).endswith("n = 6 to 7 seeds")


@pytest.mark.parametrize("conditions", [2, 6])
def test_bands_of_many_conditions_give_way_to_bars_that_are_apart(conditions):
    rows = [
        {"condition": f"c{c}", "seed": s, "iteration": i, "env_steps": i * BATCH, "goal_ratio": (i + s) / 40}
        for c in range(conditions)
        for s in range(3)
        for i in range(1, 31)
    ]
    axes = Figure().subplots()
    study_curves._curves(axes, pd.DataFrame(rows), "goal_ratio", "Goal ratio")
    bands = [c for c in axes.collections if not isinstance(c, LineCollection)]
    bars = [c for c in axes.collections if isinstance(c, LineCollection)]
    if conditions == 2:
        assert len(bands) == 2 and not bars
    else:
        assert not bands and len(bars) == 6
        at = [segment[0, 0] for lines in bars for segment in lines.get_segments()]
        assert len(at) == len(set(at)) >= 6 * 4, "no two bars at one place"


@pytest.mark.parametrize(
    ("batch", "unit", "label"), [(16_384, 1e6, "(millions)"), (512, 1e3, "(thousands)"), (16, 1, "steps")]
)
def test_steps_have_short_ticks(batch, unit, label):
    axes = Figure().subplots()
    axes.set_xlim(0, 100)
    steps_axis(axes, batch)
    (above,) = axes.child_axes
    axes.figure.draw_without_rendering()
    assert above.get_xlim() == pytest.approx((0, 100 * batch / unit))
    assert above.get_xlabel().endswith(label)
    assert all(len(tick.get_text()) <= 4 for tick in above.get_xticklabels())


FAMILY = (
    "uniform", "pec", "forgetting", "failure_ema", "learnability", "pass_at_n", "table_top", "thompson",
    "learning_progress", "dro", "plr", "sfl", "floor", "mixture", "per_step",
)  # fmt: skip


def test_a_study_of_the_whole_family_is_legible(tmp_path):
    """Every sampler has a style of its own, in the order it was named, and no legend covers a curve."""
    settings = study_settings((0.2,), (0, 1), samplers=FAMILY)
    write_study(tmp_path / "study", settings, lambda run, progress: progress)
    tables = read_study(tmp_path / "study")
    runs = measures.by_run(tables)
    assert [name.partition(",")[0] for name in dict.fromkeys(runs.condition)] == [*FAMILY]
    curves = study_curves.goal_ratio(tables)
    lines = [line for line in curves.axes[1].get_lines() if not line.get_label().startswith("_")]
    assert len({(line.get_color(), line.get_marker()) for line in lines}) == len(lines) == len(FAMILY)
    for figure in (curves, study_curves.evaluation(tables.results), study_curves.exits(tables.metrics, runs)):
        figure.draw_without_rendering()
        (legend,) = figure.legends
        assert len(legend.get_texts()) == len(FAMILY)
        covered = legend.get_window_extent()
        assert not any(covered.overlaps(axes.get_window_extent()) for axes in figure.axes)
        assert covered.x0 >= 0 and covered.x1 <= figure.bbox.x1
