"""What all figures share: colours that stay apart, one style, panel letters, files, labelled axes."""

import itertools

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from synthetic import study_settings, write_study
from test_run_figures import made_counts, made_evaluation, made_metrics

import pecjax
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.task import EvalSet
from pecjax.plotting import run as run_figures, study as study_figures, style
from pecjax.plotting.configurations import configurations
from pecjax.plotting.evaluation import evaluation
from pecjax.plotting.maps import rooms
from pecjax.studies.tables import read_study
from pecjax.training.eval_report import make_report
from pecjax.training.run_episodes import EvalResult

# Machado, Oliveira and Fernandes (2009), severity 1: what linear RGB becomes for a colour-blind eye.
COLOUR_BLIND = {
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def lab(color, eye=None):
    """CIELAB of an sRGB colour (D65), as an eye sees it."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = linear if eye is None else np.clip(np.array(COLOUR_BLIND[eye]) @ linear, 0, 1)
    ratio = XYZ @ seen / XYZ.sum(axis=1)
    x, y, z = np.where(ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16) / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def test_the_formulas_give_what_is_known():
    np.testing.assert_allclose(lab("white"), [100, 0, 0], atol=0.1)
    np.testing.assert_allclose(lab("red"), [53.24, 80.09, 67.20], atol=0.1)
    for eye in COLOUR_BLIND:  # grey stays grey
        np.testing.assert_allclose(lab("0.5", eye), lab("0.5"), atol=0.1)


def test_colours_are_apart_in_grey():
    lightness = {color: lab(color)[0] for color in style.COLORS}
    assert max(lightness.values()) < 75, "legible on white"
    for one, other in itertools.combinations(style.COLORS, 2):
        assert abs(lightness[one] - lightness[other]) > 8, (one, other)
    for one, other in itertools.combinations(style.COLORS[:3], 2):  # most figures have no more
        assert abs(lightness[one] - lightness[other]) > 20, (one, other)


@pytest.mark.parametrize("eye", COLOUR_BLIND)
def test_colours_are_apart_for_the_colour_blind(eye):
    for one, other in itertools.combinations(style.COLORS, 2):
        assert np.linalg.norm(lab(one, eye) - lab(other, eye)) > 15, (one, other)


def test_lines_differ_by_more_than_colour():
    looks = [style.style_of(number) for number in range(35)]
    assert len({(look["color"], look["marker"]) for look in looks}) == 35
    for one, other in itertools.combinations(looks[:4], 2):
        assert one["linestyle"] != other["linestyle"] and one["marker"] != other["marker"]


def test_matplotlibs_own_settings_stay():
    before = dict(matplotlib.rcParams)
    figure = run_figures.goal_ratio(made_metrics(9), made_evaluation(9), 20, True)
    assert dict(matplotlib.rcParams) == before
    figure.draw_without_rendering()  # in the settings of somebody else
    (axes,) = figure.axes
    (above,) = axes.child_axes
    ticks = [*axes.get_xticklabels(), *axes.get_yticklabels(), *above.get_xticklabels()]
    assert {tick.get_fontsize() for tick in ticks} == {style.SMALL}
    assert axes.xaxis.label.get_fontsize() == 8


def test_files_are_a_pdf_and_a_png_of_300_dpi(tmp_path):
    figure = Figure((style.COLUMN, 1))
    names = {"a": ("a.pdf", "a.png"), "b.png": ("b.pdf", "b.png"), "c.svg": ("c.pdf", "c.png", "c.svg")}
    for name, files in names.items():
        assert [path.name for path in style.save(figure, tmp_path / name)] == [*files]
    assert matplotlib.image.imread(tmp_path / "a.png").shape[1] == style.COLUMN * 300
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    style.save(figure, tmp_path / "c.svg")
    assert all(path.read_bytes() == content for path, content in before.items())


def test_letters_of_panels():
    one, many = Figure(), Figure()
    style.name_panels([one.subplots()], ["Alone"])
    assert one.axes[0].get_title("left") == "Alone"
    panels = many.subplots(4, 7).ravel().tolist()
    style.name_panels(panels, ["x"] * 28)
    titles = [axes.get_title("left") for axes in panels]
    assert titles[:2] == ["(a) x", "(b) x"] and titles[25:28] == ["(z) x", "(aa) x", "(ab) x"]


def report():
    wind, config = np.linspace(0, 8, 50), np.arange(200) % 50
    result = EvalResult(config, wind[config] < 4, np.zeros(200), np.full(200, 9), {}, None)
    about = EvalSet(np.zeros(50), group_id=np.arange(50) % 2, groups=("calm", "windy"))
    return make_report(result, about, {"wind (m/s)": wind})


@pytest.fixture(scope="module")
def all_figures(tmp_path_factory):
    """Every figure of a study and of a run, and what commands draw beside them, by name."""
    counts = made_counts(20, [1, 2]).assign(probability=0.05)
    flights = pd.DataFrame({"episode": 0, "config": 0, "ending": "goal", "x": [0.0, 1], "y": 0.0})
    figures = {
        "run goal_ratio": run_figures.goal_ratio(made_metrics(9), made_evaluation(9), 20, True),
        "run spread": run_figures.spread(counts),
        "run evaluation": run_figures.evaluations(made_evaluation(9), {}, 20, True),
        "run configurations": configurations(counts),
        "run map": rooms(pecjax.load_scene(), pecjax.COORDINATE_SET_1, flights),
        "report": evaluation(report()),
    }
    folder = tmp_path_factory.mktemp("figures") / "study"
    write_study(folder, study_settings((0.0, 0.2)), lambda run, progress: progress)
    figures |= dict(study_figures._figures(read_study(folder), Rooms(table="1")))
    return figures


def panels_of(figure):
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def test_figures_are_as_wide_as_a_column_or_a_page(all_figures):
    widths = {name: figure.get_figwidth() for name, figure in all_figures.items()}
    assert set(widths.values()) == {style.COLUMN, style.PAGE}, widths


def test_every_axis_says_what_it_is(all_figures):
    for name, figure in all_figures.items():
        for axes in panels_of(figure):
            spec = axes.get_subplotspec()
            shared = axes.get_shared_y_axes().get_siblings(axes)
            if name != "steps_to_threshold":  # the names below its x axis say it
                assert axes.get_xlabel() or not spec.is_last_row(), name
            assert axes.get_ylabel() or any(other.get_ylabel() for other in shared), name
            for label in filter(None, (axes.get_xlabel(), axes.get_ylabel())):
                assert label[0].isupper() or label[0] in "αxy", (name, label)


def test_panels_have_letters(all_figures):
    for name, figure in all_figures.items():
        titles = [axes.get_title("left") for axes in panels_of(figure)]
        lettered = [title[:3] for title in titles if title.startswith("(")]
        if len(titles) == 1:
            assert not lettered, name
        else:
            assert lettered[:2] == ["(a)", "(b)"] and len(lettered) >= len(titles) // 2, name


def test_no_title_names_a_file(all_figures):
    for name, figure in all_figures.items():
        for title in (figure.get_suptitle(), *(axes.get_title("left") for axes in figure.axes)):
            assert not any(part in title for part in ("/", ".csv", ".json", "fig4", "coordinates 1")), name


def test_legends_lie_within_the_figure_and_beside_its_axes(all_figures):
    for name, figure in all_figures.items():
        figure.draw_without_rendering()
        page = figure.bbox
        for legend in figure.legends:
            extent = legend.get_window_extent()
            assert page.x0 <= extent.x0 and extent.x1 <= page.x1 and extent.y0 >= page.y0, name
            assert not any(extent.overlaps(axes.get_window_extent()) for axes in figure.axes), name
