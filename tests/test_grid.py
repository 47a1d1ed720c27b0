"""Grids of any setting: which runs there are, which share a program, and what is reported of them."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
from synthetic import study_settings, write_study
from test_settings_tree import OWN

from pecjax import InputError, cli, settings_tree
from pecjax.curriculum import SamplerSettings, by_group, pec, uniform
from pecjax.plotting import study as study_figures
from pecjax.studies import measures, report as study_report
from pecjax.studies.catalogue import find_study
from pecjax.studies.grid import RunSpec, StudySettings, fixed, read_grid
from pecjax.studies.run import run_study
from pecjax.training.presets import PRESETS

RUN = PRESETS["fast"]
RATES = ("agent.learning_rate", (1e-4, 3e-4))
FLOORS = ("sampler.floor", (0.05, 0.5))
SAMPLERS = ("sampler", ("pec", OWN, "uniform"))
GRID = StudySettings("own", RUN, (SAMPLERS, ("sampler.alpha", (0.1, 0.2)), RATES, FLOORS), seeds=(0, 1))


@pytest.fixture(scope="module", autouse=True)
def around_flights(gliding):
    """What is tested here does not depend on how the drone flies."""


def test_every_combination_is_a_run_and_a_sampler_has_its_own_settings_only():
    GRID.check()
    runs = [member for group in GRID.groups() for member in group]
    assert len(runs) == len(set(runs))
    by_sampler = pd.Series([dict(member.values)["sampler"] for member in runs]).value_counts()
    assert by_sampler.to_dict() == {"pec": 2 * 2 * 2, OWN: 2 * 2 * 2, "uniform": 2 * 2}
    assert set(runs) == {member for part in GRID.batches() for member in part}
    for member in runs:
        settings = GRID.settings_of(member)
        assert settings.agent.learning_rate == dict(member.values)["agent.learning_rate"]
        for name in ("alpha", "floor"):
            assert getattr(settings.sampler, name, None) == dict(member.values).get(f"sampler.{name}")


def test_what_differs_in_numbers_of_the_sampler_alone_shares_a_program():
    groups = GRID.groups()
    assert len(groups) == 3 * 2  # samplers × learning rates
    for group in groups:
        (alike,) = {fixed(member.values) for member in group}
        assert {name for name, _ in alike} == {"sampler", "agent.learning_rate"}
        assert all(dict(alike).items() <= dict(member.values).items() for member in group)
        varied = GRID.numbers(group)
        assert [*varied] == {"pec": ["alpha"], OWN: ["floor"], "uniform": []}[dict(alike)["sampler"]]
        for name, values in varied.items():
            assert values == [dict(member.values)[f"sampler.{name}"] for member in group]


def test_settings_that_are_tried_together_are_tried_with_all_of_the_grid():
    together = ((("sampler", "uniform"),), (("sampler", "pec"), ("sampler.alpha", 0.1)), (("sampler", OWN),))
    study = replace(GRID, grid=(RATES,), conditions=together, seeds=(3,))
    study.check()
    runs = [dict(member.values) for group in study.groups() for member in group]
    expected = [dict(values) | {"agent.learning_rate": rate} for values in together for rate in RATES[1]]
    assert sorted(map(str, runs)) == sorted(str(of_run) for of_run in expected)
    assert study.paths() == ["agent.learning_rate", "sampler", "sampler.alpha"]
    assert study.values_of("sampler") == ("uniform", "pec", OWN) and study.values_of("sampler.alpha") == (
        0.1,
    )
    assert settings_tree.from_json(settings_tree.to_json(study), StudySettings) == study
    with pytest.raises(InputError, match="sampler name a setting twice"):
        replace(study, grid=(SAMPLERS,)).check()
    with pytest.raises(InputError, match=r"none of uniform has sampler.alpha"):
        replace(study, conditions=((("sampler", "uniform"), ("sampler.alpha", 0.1)),)).check()


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("agent.learning-rate", "1e-4", "3e-4"), RATES),
        (("agent.num_epochs", "2", "4"), ("agent.num_epochs", (2, 4))),
        (("agent.shuffle", "steps", "samples"), ("agent.shuffle", ("steps", "samples"))),
        (("sampler.floor", "0.05", "0.5"), FLOORS),
        (("task.goal-radius", "0.3", "1"), ("task.goal_radius", (0.3, 1.0))),
        (("sampler", "pec", OWN), ("sampler", ("pec", OWN))),
        (("agent.network.memory", "none", "gru"), ("agent.network.memory", (None, "gru"))),
    ],
)
def test_words_are_values_of_the_settings_type(words, found):
    assert read_grid(RUN, ("pec", OWN), words) == found


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--grid", "agent.learning_rate"], "'agent.learning_rate' has no values"),
        (["--grid", "agent.lerning_rate", "1"], "agent.lerning_rate (did you mean learning_rate?)"),
        (["--grid", "task.task_kind", "x"], "no setting task.task_kind"),
        (["--grid", "agent.learning_rate", "fast"], "agent.learning_rate is 'fast'; it takes float"),
        (["--grid", "agent.network.hidden", "64"], "agent.network.hidden is '64'"),
        (["--grid", "agent.shuffle", "steps", "rows"], "agent.shuffle is 'rows'; it takes steps or samples"),
        (
            ["--grid", "agent.network.memory", "lstm"],
            "agent.network.memory is 'lstm'; it takes gru or mingru or stack or none",
        ),
        (["--grid", "agent.num_epochs", "none", "2"], "agent.num_epochs is None; it takes int"),
        (["--grid", "sampler", "none"], "unknown sampler 'none'"),
        (["--grid", "agent.learning_rate", "1e-4", "1e-4"], "names 0.0001 more than once"),
        (
            ["--grid", "agent.clip_epsilon", "0.1", "--grid", "agent.clip_epsilon", "0.2"],
            "agent.clip_epsilon is given twice",
        ),
        (["--grid", "agent.num_minibatches", "8", "5"], "5 minibatches do not divide 32 steps"),
        (["--grid", "stop.iterations", "3", "4"], "stop.iterations is not of task, sampler or agent"),
        (["--grid", "seed", "3", "4"], "seed is not of task, sampler or agent"),
        (["--grid", "agent", "ppo", "apex"], "all runs of a study share their agent; give it with --agent"),
        (["--grid", "agent.batch_size", "8", "16"], "no setting agent.batch_size"),
        (["--alphas", "0", "1", "--grid", "sampler.alpha", "0", "1"], "sampler.alpha is given twice"),
        (["--grid", "sampler.floor", "0", "1"], "no setting sampler.floor"),
    ],
)
def test_grids_that_cannot_be_run_get_one_line_and_leave_nothing(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli.devices, "use_all_cores", lambda: None)
    monkeypatch.setattr(cli.devices, "keep_compiled_programs", lambda: None)
    assert cli.main(["study", *words]) == 2
    out, err = capsys.readouterr()
    assert said in err and err.count("\n") == 1 and out == ""
    assert list(tmp_path.iterdir()) == []


@dataclass(frozen=True)
class WithoutNumbers(SamplerSettings):
    floor: float = 0.1

    def make(self, num_configs):
        return uniform(num_configs)._replace(init=lambda: uniform(num_configs).init())


def test_a_sampler_whose_state_lacks_the_number_is_refused():
    own = f"{__name__}:WithoutNumbers"
    alone = ("sampler", (own,))
    configurations = {GRID.run.task: 20}
    replace(GRID, grid=(alone,)).check_samplers(configurations)
    with pytest.raises(InputError, match=r"WithoutNumbers: its init does not take floor .* in its state"):
        replace(GRID, grid=(alone, FLOORS)).check_samplers(configurations)


@dataclass(frozen=True)
class OfTwenty(SamplerSettings):
    def make(self, num_configs):
        return by_group(pec(2), np.arange(num_configs).reshape(20, -1)[:, 0] % 2)


def test_a_sampler_is_made_over_the_configurations_that_there_are():
    study = replace(GRID, grid=(("sampler", (f"{__name__}:OfTwenty",)),))
    study.check()
    study.check_samplers({GRID.run.task: 20})


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    """A study whose goal ratios follow from the learning rate and the sampler."""
    folder = tmp_path_factory.mktemp("grid") / "study"
    settings = study_settings(samplers=SAMPLERS[1])
    settings = replace(settings, grid=(*settings.grid, RATES, FLOORS))

    def ratio(run, progress):
        better = {"alpha": 0.1, "floor": getattr(run.sampler, "floor", 0.0)}
        gain = sum(more for name, more in better.items() if hasattr(run.sampler, name))
        return progress * (0.4 + gain + (run.agent.learning_rate > 2e-4) * 0.1)

    write_study(folder, settings, ratio)
    return folder


def test_tables_have_a_column_for_every_path_with_all_digits(made_up):
    results = pd.read_csv(made_up / "results.csv", dtype=str)
    assert set(results["agent.learning_rate"]) == {"0.0001", "0.0003"}
    floors = results.groupby("sampler")["sampler.floor"].agg(lambda column: set(column.dropna()))
    assert floors.to_dict() == {"pec": set(), OWN: {"0.05", "0.5"}, "uniform": set()}
    assert len(results) == 3 * 2 * (1 + 2 + 1) * results.iteration.nunique()


def test_conditions_are_compared_at_equal_settings_of_the_learner(made_up):
    study_report.write_report(made_up)
    paired = pd.read_csv(made_up / "paired.csv")
    last = paired[paired.measure == "goal_ratio"]
    assert len(last) == 2 * 3  # learning rates × (PEC and two floors)
    for row in last.itertuples():
        rate = row.condition.partition("learning_rate = ")[2].partition(",")[0]
        assert row.baseline == f"uniform, learning_rate = {rate}"
    found = last.set_index("condition").difference
    # Ratios are of ten episodes each.
    np.testing.assert_allclose(found["pec, α = 0.2, learning_rate = 0.0001"], 0.1, atol=0.06)
    np.testing.assert_allclose(found["Learnability, learning_rate = 0.0003, floor = 0.5"], 0.5, atol=0.06)


def test_its_figures_have_names_of_their_own(made_up, monkeypatch):
    monkeypatch.setattr(study_figures, "save", lambda figure, path: [path])  # most of the time is theirs
    names = [path.name for path in study_figures.draw_study(made_up)]
    assert len(set(names)) == len(names)
    assert "configurations-Learnability-learning_rate-0.0003-floor-0.5" in names
    assert "alpha" not in names  # it would mix learning rates


def test_conditions_without_a_setting_are_paired_among_themselves():
    runs = pd.DataFrame([
        {"coordinates": "1", "condition": f"{sampler}, {memory}", "seed": seed, "sampler": sampler}
        | {"agent.network.memory": memory or np.nan}
        | dict.fromkeys((*measures.RATIOS, *measures.STEPS), float(seed))
        for sampler in ("pec", "uniform")
        for memory in (None, "gru")
        for seed in (0, 1)
    ])  # fmt: skip
    found = {(row["condition"], row["baseline"]) for row in measures.paired(runs)}
    assert found == {("pec, None", "uniform, None"), ("pec, gru", "uniform, gru")}


KIND = ("sampler", "forgetting")
SOME_NUMBERS = ((KIND,), (KIND, ("sampler.alpha", 5.0)), (KIND, ("sampler.half_life", 0.5)))


def test_a_number_that_only_some_runs_vary_has_its_default_in_the_others():
    study = replace(GRID, grid=(RATES,), conditions=SOME_NUMBERS, seeds=(3,))
    specs = [RunSpec(3, values) for values in SOME_NUMBERS]
    assert study.numbers(specs) == {"alpha": [0.2, 5.0, 0.2], "half_life": [20.0, 20.0, 0.5]}
    assert study.numbers(specs[:1]) == {}


@pytest.mark.slow
def test_a_run_with_a_default_is_the_same_beside_one_that_changes_it(tmp_path):
    study = replace(find_study("fig4", "smoke"), seeds=(3,), grid=(), conditions=SOME_NUMBERS[:2])
    run_study(study, tmp_path / "together")
    found = pd.read_csv(tmp_path / "together" / "metrics.csv")
    both = []
    for values, alpha in zip(SOME_NUMBERS, (0.2, 5.0), strict=False):
        folder = tmp_path / f"{alpha}"
        run_study(replace(study, conditions=(values,)), folder)
        columns = ["iteration", "episodes", "mean_return"]
        wanted = pd.read_csv(folder / "metrics.csv")[columns]
        pd.testing.assert_frame_equal(found[found.alpha == alpha][columns].reset_index(drop=True), wanted)
        both.append(wanted)
    assert not both[0].equals(both[1])


@pytest.mark.slow
def test_a_run_of_a_grid_is_the_run_that_its_settings_make(tmp_path):
    smoke = find_study("fig4", "smoke")
    space, own = ("task.table", ("1",)), ("sampler", (OWN,))
    study = replace(smoke, seeds=(3,), grid=(space, own, FLOORS, ("agent.learning_rate", (1e-3, 1e-2))))
    run_study(study, tmp_path / "grid")
    found = pd.read_csv(tmp_path / "grid" / "metrics.csv")
    assert found.groupby(["sampler.floor", "agent.learning_rate"]).size().tolist() == [4] * 4
    member = next(m for part in study.batches() for m in part if study.numbers([m]) == {"floor": [0.5]})
    settings = study.settings_of(member)
    alone = replace(study, run=settings, grid=(space, own, ("sampler.floor", (0.5,))))
    run_study(alone, tmp_path / "alone")
    rate = settings.agent.learning_rate
    rows = found[(found["sampler.floor"] == 0.5) & (found["agent.learning_rate"] == rate)]
    wanted = pd.read_csv(tmp_path / "alone" / "metrics.csv")
    columns = ["iteration", "env_steps", "goal_ratio", "episodes", "mean_return"]
    # As floats, since a ratio that is 0 throughout is read as integers.
    rows, wanted = (table[columns].reset_index(drop=True).astype(float) for table in (rows, wanted))
    pd.testing.assert_frame_equal(rows, wanted, rtol=1e-5)
