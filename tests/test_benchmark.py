"""The benchmark of samplers: its studies, and a report beside plain loops over its results."""

import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pecjax import InputError, cli
from pecjax.envs.task import num_configs
from pecjax.errors import DivergedError
from pecjax.plotting import benchmark as figures
from pecjax.studies import benchmark
from pecjax.studies.benchmark import CELLS, CONFIRMATION, SCREENING, STUDIES
from pecjax.studies.benchmark_measures import by_run, compare, compare_together, read_cells
from pecjax.studies.benchmark_report import in_short, scores, write_benchmark_report
from pecjax.studies.run import run_study
from pecjax.training.kinds import make_kind

STEPS = np.arange(1, 11) * 100_000
SEEDS = range(6)
STORED = sorted((Path(__file__).parents[1] / "docs" / "results").glob("samplers-*"))


def curve(sampler: str, seed: int) -> np.ndarray:
    """Goal ratios that rise to about 1, sooner under pec."""
    draw = np.random.default_rng([seed, len(sampler)])
    pace = {"uniform": 2.0, "pec": 3.0, "dro": 2.0}[sampler] * np.exp(draw.normal(0, 0.1))
    return 1 - np.exp(-pace * STEPS / 300_000)


def results(samplers=("uniform", "pec", "dro")) -> pd.DataFrame:
    rows = [
        {"sampler": s, "alpha": 0.2 if s == "pec" else np.nan, "sampler.step": 0.1 if s == "dro" else np.nan}
        | {"seed": seed, "iteration": i + 1, "env_steps": STEPS[i], "goal_ratio": ratio}
        | {"unbiased_cvar": ratio**2, "goal_ratio.hard": ratio / 2}
        for s, seed in product(samplers, SEEDS)
        for i, ratio in enumerate(curve(s, seed))
    ]
    return pd.DataFrame(rows)


@pytest.fixture
def folder(tmp_path):
    for cell in ("rooms-pairs", "rooms-storm"):
        (tmp_path / cell).mkdir()
        results().to_csv(tmp_path / cell / "results.csv", index=False)
    return tmp_path


@pytest.mark.parametrize("name", STUDIES)
def test_its_studies_can_be_run_and_begin_alike(name):
    for study in STUDIES[name].values():
        study.check()
    full, laptop = STUDIES[name]["full"], STUDIES[name]["laptop"]
    assert full.run == laptop.run and full.seeds[:3] == laptop.seeds  # a laptop's runs are the first of all
    iterations = full.run.stop.iterations
    assert iterations % full.run.evaluation.every == 0, "the last evaluation is as far as the others"


@pytest.mark.parametrize("name", CELLS)
def test_evaluations_fly_each_held_out_configuration_twice(name):
    run = STUDIES[f"samplers-{name}"]["full"].run
    _, world = run.task.make()
    assert run.evaluation.episodes == 2 * num_configs(run.task.eval_set(world).table)
    measured = CELLS[name].measured.partition(".")[2]
    assert not measured or measured in run.task.eval_set(world).groups


def test_screening_tries_the_whole_family_on_seeds_of_its_own():
    family = {make_kind("sampler", str(dict(values)["sampler"])) for values in SCREENING}
    assert len(family) == 15 and len(set(SCREENING)) == len(SCREENING)
    for name in benchmark.SCREENED:
        study = STUDIES[f"samplers-{name}"]
        assert not set(study["screening"].seeds) & set(study["full"].seeds)
        run, screened = study["full"].run, study["screening"].run
        flights = run.evaluation.episodes // 2  # one of each configuration
        assert screened == replace(run, evaluation=replace(run.evaluation, episodes=flights))
    assert set(CONFIRMATION) <= set(SCREENING)


def test_runs_have_the_figures_of_plain_loops():
    cell, table = CELLS["rooms-longtail"]._replace(thresholds=(0.2, 0.4, 0.6)), results()
    table["condition"] = table.sampler
    runs = by_run(table, cell).set_index(["condition", "seed"])
    for sampler, seed in product(("uniform", "pec", "dro"), SEEDS):
        ratios = curve(sampler, seed)
        row = runs.loc[sampler, seed]
        assert row["goal_ratio"] == pytest.approx(ratios[-1]) and row["unbiased_cvar"] == pytest.approx(
            ratios[-1] ** 2
        )
        area = sum((ratios[1:] + ratios[:-1]) / 2 / 2) / 9  # of the hard half
        assert row["area"] == pytest.approx(area)
        for at in (0.2, 0.4):
            assert row[f"steps_to_{at}"] == pytest.approx(np.interp(at, ratios / 2, STEPS))
        assert row["steps_to_0.6"] == STEPS[-1]


def test_what_diverged_in_any_cell_is_told_after_the_report(folder, tmp_path, monkeypatch, capsys):
    made = ["rooms-pairs", "rooms-storm"]

    def run(settings, cell, notice):
        if cell.name in made:
            shutil.copytree(folder / cell.name, cell)
            return
        cell.mkdir(parents=True)
        (cell / "results.csv").write_text("\n")
        raise DivergedError(f"{cell.name}: all runs diverged")

    monkeypatch.setattr("pecjax.commands.study.run_study", run)
    monkeypatch.setattr("pecjax.studies.shares.write_shares", lambda cell: None)
    there = tmp_path / "there"
    words = ["study", "samplers", "--scale", "smoke", "--out", str(there)]
    assert cli.main(words) == 1
    out, err = capsys.readouterr()
    assert "## rooms-pairs" in out and "## rooms-storm" in out and (there / "figures").is_dir()
    assert all((f"{name}: all runs diverged" in err) == (name not in made) for name in CELLS)
    shutil.rmtree(there)
    made.clear()
    assert cli.main(words) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("all runs diverged") == len(CELLS)


def test_a_cell_whose_runs_all_diverged_is_left_out(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "there")
    (tmp_path / "there" / "rooms-storm" / "results.csv").write_text("\n")
    assert set(read_cells(tmp_path / "there")) == {"rooms-pairs"}


def test_comparisons_are_of_pairs_and_the_first_ones_are_corrected_together(folder):
    cells = read_cells(folder)
    assert set(cells) == {"rooms-pairs", "rooms-storm"}
    rows = compare({name: by_run(table, CELLS[name]) for name, table in cells.items()})
    table = pd.DataFrame(rows).set_index(["cell", "condition", "measure"])
    middle = f"steps_to_{CELLS['rooms-pairs'].thresholds[1]:g}"
    found = table.loc["rooms-pairs", "pec, α = 0.2", middle]
    ours, theirs = (
        by_run(cells["rooms-pairs"], CELLS["rooms-pairs"]).query("condition.str.startswith(@s)")[middle]
        for s in ("pec", "uniform")
    )
    assert found.value == pytest.approx(np.exp(np.mean(np.log(ours.to_numpy() / theirs.to_numpy()))) - 1)
    assert found.value < -0.2 and found.high < 0 and found.pairs == 6
    assert (
        found.p == 2 / 2**6 and found.p_holm == 4 / 2**6 * 2
    )  # the least of four comparisons, which two have
    ends = table.loc["rooms-pairs", "pec, α = 0.2", "goal_ratio"]
    differences = [curve("pec", seed)[-1] - curve("uniform", seed)[-1] for seed in SEEDS]
    assert ends.value == pytest.approx(np.mean(differences)) and not ends["first"]
    assert table.loc["rooms-pairs", "uniform", middle].value == 0
    logs = [
        np.mean([np.log1p(table.loc[(cell, "pec, α = 0.2", f"steps_to_{at:g}"), "value"]) for at in at_all])
        for cell, at_all in ((cell, CELLS[cell].thresholds) for cell in cells)
    ]
    expected = [np.expm1(log) for log in (*logs, np.mean(logs))]
    assert logs[0] != logs[1]
    columns = " | ".join(f"{score:+.0%}" for score in expected)
    assert scores(rows).splitlines()[2] == f"| pec, α = 0.2 | {columns} |"
    firsts, at_the_end = in_short(rows, []).split("\n\n")
    assert f"{found.value:+.0%} [{found.low:+.0%}, {found.high:+.0%}]" in firsts.splitlines()[2]
    assert f"{ends.value:+.2f} [{ends.low:+.2f}, {ends.high:+.2f}]" in at_the_end.splitlines()[2]


def test_cells_under_ppo_have_a_mean_that_weighs_them_alike(folder):
    shutil.copytree(folder / "rooms-pairs", folder / "rooms-pairs-apex")
    runs = {name: by_run(table, CELLS[name]) for name, table in read_cells(folder).items()}
    rows = pd.DataFrame(compare(runs)).query("first and condition == 'pec, α = 0.2'").set_index("cell")
    found = {row["condition"]: row for row in compare_together(runs)}
    assert list(found) == ["dro, step = 0.1", "pec, α = 0.2"]
    mean = np.log1p(rows.value[["rooms-pairs", "rooms-storm"]].astype(float)).mean()
    assert found["pec, α = 0.2"]["value"] == pytest.approx(np.expm1(mean))
    head, _, *lines = write_benchmark_report(folder).partition("## In short")[2].split("\n\n")[1].splitlines()
    assert head == "| steps, over uniform | rooms-pairs | rooms-storm | rooms-pairs-apex | mean under PPO |"
    texts = [f"{found['pec, α = 0.2'][which]:+.0%}" for which in ("value", "low", "high")]
    assert lines[0].endswith("| {} [{}, {}] |".format(*texts))
    assert compare_together({"rooms-pairs": runs["rooms-pairs"]}) == []


def test_the_figures_show_the_table_and_the_curves(folder):
    cells = read_cells(folder)
    rows = pd.DataFrame(compare({name: by_run(table, CELLS[name]) for name, table in cells.items()}))
    first = rows[rows["first"] & (rows.cell == "rooms-pairs")]
    panel = figures.steps(rows).axes[0]
    (bars,) = panel.containers
    np.testing.assert_allclose(bars.lines[0].get_xdata(), 100 * first.value.to_numpy(float))
    ends = np.array([segment[:, 0] for segment in bars.lines[2][0].get_segments()])
    np.testing.assert_allclose(ends, 100 * first[["low", "high"]].to_numpy(float))
    assert [label.get_text() for label in panel.get_yticklabels()] == list(first.condition)
    (line, *_) = figures.curves(cells).axes[0].lines
    np.testing.assert_allclose(line.get_ydata(), np.mean([curve("uniform", seed) for seed in SEEDS], axis=0))


def test_all_runs_that_reached_a_threshold_are_counted(folder):
    """The slowest of them, too; and what never did is named."""
    text = write_benchmark_report(folder)
    (row,) = [
        line for line in text.partition("## rooms-storm")[0].splitlines() if line.startswith("| uniform")
    ]
    assert " of 6)" not in row and "never" not in row  # every curve passes 0.95 before its end
    late = results()
    late["goal_ratio"] /= 4
    late.to_csv(folder / "rooms-storm" / "results.csv", index=False)
    assert "never (0 of 6)" in write_benchmark_report(folder)


def test_uniform_sampling_alone_has_a_report(tmp_path):
    (tmp_path / "tasks").mkdir()
    results(("uniform",)).to_csv(tmp_path / "tasks" / "results.csv", index=False)
    assert "| uniform |" in write_benchmark_report(tmp_path)
    assert [path.name for path in figures.draw_benchmark(tmp_path)] == ["curves.pdf", "curves.png"]


def test_where_steps_went_is_counted_until_uniform_sampling_is_half_way(folder):
    """And κ is the share of what is learnable over that of uniform sampling."""
    per_run = pd.DataFrame(
        {"condition": condition, "seed": seed, "env_steps": at, "out_of_reach": 0.5 - learnable}
        | {"learnable": learnable + at / 1e7, "mastered": 0.5 - at / 1e7}
        for condition, learnable in (("uniform", 0.2), ("pec, α = 0.2", 0.3))
        for seed, at in product(SEEDS, STEPS)
    )
    per_run.to_csv(folder / "rooms-pairs" / "shares.csv", index=False)
    text = write_benchmark_report(folder)
    pairs, _, storm = text.partition("## rooms-storm: 6 seeds")
    part = pairs.partition("Where steps went")[2]
    rows = {line.split(" | ")[0].strip("| "): line for line in part.splitlines() if line.startswith("| ")}
    middle = CELLS["rooms-pairs"].thresholds[1]
    until = np.median([np.interp(middle, curve("uniform", seed), STEPS) for seed in SEEDS])
    along = np.mean([at for at in STEPS if at <= until]) / 1e7
    assert 100_000 < until < STEPS[-1]
    kappa = (0.3 + along) / (0.2 + along)
    figures = f"0.20 | {0.3 + along:.2f} | {0.5 - along:.2f} | {kappa:.2f} | {1 / kappa - 1:+.0%} | "
    compared = pd.read_csv(folder / "comparisons.csv").query("first and cell == 'rooms-pairs'")
    found = compared.set_index("condition").value["pec, α = 0.2"]
    assert rows["pec, α = 0.2"] == f"| pec, α = 0.2 | {figures}{found:+.0%} |"
    assert rows["uniform"].endswith("| 1.00 | +0% |  |") and "Where steps went" not in storm


def test_what_chance_would_give_is_that_of_plain_loops(folder):
    lines = write_benchmark_report(folder).partition("## By chance")[2].partition("##")[0].splitlines()
    (line,) = [line for line in lines if line.startswith("| rooms-pairs")]
    middle = CELLS["rooms-pairs"].thresholds[1]
    logs = [[np.log(np.interp(middle, curve(s, k), STEPS)) for k in SEEDS] for s in ("uniform", "pec", "dro")]
    within = np.sqrt(np.mean([np.std(of, ddof=1) ** 2 for of in logs]))
    found = np.std([np.mean(of) for of in logs], ddof=1)
    assert within > 0.05
    assert line == f"| rooms-pairs | {within:.2f} | {within / np.sqrt(6):.2f} | {found:.2f} |"


def test_a_run_that_is_missing_never_reached_anything():
    table = results()
    table["condition"] = table.sampler
    table = table[~((table.sampler == "pec") & (table.seed == 2))]
    runs = by_run(table, CELLS["rooms-pairs"]).set_index(["condition", "seed"])
    assert len(runs) == 18 and np.isnan(runs.loc["pec", 2]["goal_ratio"])
    assert (runs.loc["pec", 2].filter(like="steps_to") == STEPS[-1]).all()
    (row,) = [
        row
        for row in compare({"rooms-pairs": runs.reset_index()})
        if row["condition"] == "pec" and row["first"]
    ]
    assert row["pairs"] == 6
    with pytest.raises(InputError, match="rooms-pairs: there are no runs of uniform"):
        compare({"rooms-pairs": by_run(table[table.sampler != "uniform"], CELLS["rooms-pairs"])})


def test_its_report_is_rebuilt_byte_for_byte(folder, capsys):
    names = ("runs.csv", "comparisons.csv", "report.md", "figures/steps.png", "figures/curves.png")
    files = [folder / name for name in names]
    text = write_benchmark_report(folder)
    again = ["study", "report", "--out", str(folder)]
    assert cli.main(again) == 0 and text in capsys.readouterr().out
    before = [file.read_bytes() for file in files]
    assert before[2].decode() == text and "## rooms-storm: 6 seeds" in text and "| pec, α = 0.2 |" in text
    for file in files:
        file.unlink()
    assert cli.main(again) == 0
    assert [file.read_bytes() for file in files] == before
    with pytest.raises(InputError, match=r"nor CELL/results\.csv of paper-2"):
        write_benchmark_report(folder / "rooms-pairs")


@pytest.mark.parametrize("stored", STORED, ids=lambda folder: folder.name)
def test_the_stored_report_is_that_of_the_stored_results(stored, tmp_path):
    """Its figures, too."""
    for results in stored.glob("*/results.csv"):
        shutil.copytree(results.parent, tmp_path / results.parent.name)
    write_benchmark_report(tmp_path)
    figures.draw_benchmark(tmp_path)
    drawn = sorted(path.relative_to(tmp_path) for path in (tmp_path / "figures").glob("*.png"))
    assert drawn == sorted(path.relative_to(stored) for path in (stored / "figures").glob("*.png"))
    for name in ("runs.csv", "comparisons.csv", "report.md", *drawn):
        assert (tmp_path / name).read_bytes() == (stored / name).read_bytes()


@pytest.mark.slow
def test_one_pair_of_a_cell_is_repeated_to_the_last_digit(tmp_path):
    """At the size of the benchmark's programs, where XLA rounds elsewhere when there is one run in them."""
    study = STUDIES["samplers-rooms-pairs"]["smoke"]
    run_study(study, tmp_path / "all")
    run_study(replace(study, seeds=(1,)), tmp_path / "one")
    found, every = (pd.read_csv(tmp_path / name / "results.csv") for name in ("one", "all"))
    assert len(found) == 2 * len(CONFIRMATION)  # evaluations of each sampler
    pd.testing.assert_frame_equal(found, every[every.seed == 1].reset_index(drop=True), check_dtype=False)
