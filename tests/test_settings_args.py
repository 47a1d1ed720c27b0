"""Settings on the command line: every leaf by its path, and what is wrong in one line."""

import contextlib
import typing
from dataclasses import replace
from pathlib import Path

import pytest

from pecjax import cli, settings_tree
from pecjax.commands import settings_args, train
from pecjax.commands.study import Study
from pecjax.commands.train import Train
from pecjax.curriculum import PEC, Floor, TableTop, Uniform
from pecjax.studies.grid import shown_space, space_name
from pecjax.training import presets

OF_TRAIN = {"preset", "seed"}


def settable(agent):
    """The paths that have no option of their own only, with their values."""
    return {
        path: value
        for path, value in settings_tree.leaves(presets.find_preset(agent=agent))
        if path not in OF_TRAIN
    }


def another(agent, path, value):
    """Some other value that the leaf may have."""
    tree = presets.find_preset(agent=agent)
    *parents, name = path.split(".")
    for parent in parents:
        tree = getattr(tree, parent)
    choices = typing.get_args(typing.get_type_hints(type(tree))[name])
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return next((choice for choice in choices if choice != value), "other.csv")
    if name == "drag":  # always three
        return (*value[:2], 7.0)
    if isinstance(value, tuple):
        return (*value, "other.xml" if str in choices else 7)
    if value is None and typing.get_origin(choices[0]) is typing.Literal:
        return typing.get_args(choices[0])[0]
    if value is None:
        return (20, 10) if name == "resolution" else 3
    return value + 1


def words_for(path, value):
    option = "--" + path.replace("_", "-")
    if isinstance(value, bool):
        parent, _, name = option.removeprefix("--").rpartition(".")
        return [option] if value else [f"--{parent}{'.' * bool(parent)}no-{name}"]
    return [option, *map(str, value if isinstance(value, tuple) else (value,))]


CASES = [(agent, path) for agent in ("ppo", "apex") for path in settable(agent)]


def test_the_cases_are_of_the_whole_tree():
    of_both = {path for _, path in CASES}
    assert {
        "task.table", "task.maps", "task.resolution", "task.goal_radius", "task.gains.turn_feed_forward",
        "sampler.alpha", "agent.network.hidden", "agent.replay.capacity", "evaluation.greedy",
        "stop.until_goal_ratio", "configurations_every",
    } <= of_both  # fmt: skip


@pytest.mark.parametrize(("agent", "path"), CASES, ids=lambda case: case)
def test_every_leaf_can_be_set(agent, path):
    """As `set_path` does, which is tested by itself."""
    value = another(agent, path, settable(agent)[path])
    kept, settings = settings_args.split(
        ["train", "--seed", "3", *words_for(path, value), "--out", "x"], Train
    )
    assert kept == ["train", "--seed", "3", "--out", "x"]
    base = presets.find_preset(agent=agent)
    found = settings_args.apply(base, settings, Train)
    assert found == settings_tree.set_path(base, path, value) != base


def test_none_can_be_said(monkeypatch):
    found = run_with(monkeypatch, "--agent.max-grad-norm", "none", "--agent.kl-coeff", "0.2")
    assert found.agent.max_grad_norm is None and found.agent.kl_coeff == 0.2


def run_with(monkeypatch, *words):
    """The settings that a training would be started with."""
    seen = []

    class SeenError(Exception):
        pass

    def begin(settings, *_):
        seen.append(settings)
        raise SeenError

    monkeypatch.setattr(train.training, "train", begin)
    with contextlib.suppress(SeenError):
        cli.parse(["train", *words]).run()
    return seen[0]


def test_paths_and_options_of_the_command_go_together(monkeypatch):
    found = run_with(
        monkeypatch, "--preset", "rllib085", "--sampler.alpha", "0.7", "--agent.network.hidden", "8", "9",
        "--evaluation.every=7", "--num-envs", "50", "--evaluation.no-greedy", "--iterations", "9",
        "--scene", "a.xml", "more", "--task.resolution", "20", "10", "--configurations-every", "3",
    )  # fmt: skip
    wanted = presets.find_preset("rllib085")
    for path, value in (
        ("sampler.alpha", 0.7),
        ("agent.network.hidden", (8, 9)),
        ("evaluation.every", 7),
        ("agent.num_envs", 50),
        ("evaluation.greedy", False),
        ("stop.iterations", 9),
        ("task.maps", ("a.xml", "more")),
        ("task.resolution", (20, 10)),
        ("configurations_every", 3),
    ):
        wanted = settings_tree.set_path(wanted, path, value)
    assert found == wanted


def test_the_numbers_are_those_of_the_sampler_that_is_named(monkeypatch):
    named = "test_settings_tree:Learnability"
    found = run_with(monkeypatch, "--sampler", named, "--sampler.floor", "0.3")
    assert settings_tree.to_json(found)["sampler"] == {"kind": named, "floor": 0.3, "power": 1.0}


def test_the_numbers_are_those_of_the_agent_and_the_task_that_are_named(monkeypatch):
    own = ["test_settings_tree:Patient", "test_settings_tree:WindyRooms"]
    found = run_with(
        monkeypatch, "--agent", own[0], "--task", own[1], "--agent.patience", "7", "--task.wind", "5"
    )
    content = settings_tree.to_json(found)
    assert [content[slot]["kind"] for slot in ("agent", "task")] == own
    assert found.agent.patience == 7 and found.task.wind == 5.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["train", "--sampler.alhpa", "1"], "unknown option --sampler.alhpa (did you mean --sampler.alpha?)"),
        (["train", "--sampler", "uniform", "--sampler.alpha", "1"], "unknown option --sampler.alpha"),
        (["train", "--agent.shuffle", "stps"], "invalid choice 'stps' for argument '--agent.shuffle'"),
        (["train", "--agent.num-envs", "many"], "--agent.num-envs takes a whole number, not 'many'"),
        (["train", "--agent.clip-epsilon", "much"], "--agent.clip-epsilon takes a number, not 'much'"),
        (["train", "--agent.clip-epsilon"], "Missing value for argument '--agent.clip-epsilon'"),
        (["train", "--agent.batch-size", "8"], "unknown option --agent.batch-size"),
        (["train", "--agent", "apex", "--agent.clip-epsilon", "1"], "unknown option --agent.clip-epsilon"),
        (["train", "--ppo.clip", "0.1"], "unknown option --ppo.clip"),
        (["train", "--task.goal-radus", "1"], "(did you mean --task.goal-radius?)"),
        (["train", "--task.resolution", "20"], "--task.resolution"),
        (["train", "--agent.num-minibatches", "5"], "5 minibatches do not divide 32 steps"),
        (["train", "--sampler.alpha", "-1"], "alpha is -1"),
        (["train", "--agent.network.hidden"], "hidden has 0 layers"),
        (
            ["train", "--agent.network.memory", "gru", "--agent.num-minibatches", "0"],
            "environments, steps, epochs and minibatches must each be 1 or more",
        ),
        (["train", "--agent", "apex", "--agent.batch-size", "0"], "batch-size and shards must each be 1"),
        (["study", "--alphas", "-1"], "alpha is -1"),
        (["study", "fig14", "--samplers", "pec", "plr"], "signal is None; the sampler needs it"),
        (["train", "--agent.clip-epsilon", "nan"], "clip-epsilon is nan"),
        (["train", "--stop.iterations", "0"], "iterations is 0"),
        (
            ["train", "--sampler", "floor", "--sampler.sampler"],
            "--sampler.sampler has no value; give the name",
        ),
        (["train", "--sampler", "floor", "--sampler.sampler", "tabletop"], "(did you mean table_top?)"),
        (
            ["train", "--sampler", "floor", "--sampler.sampler.alpha", "1"],
            "unknown option --sampler.sampler.alpha",
        ),
        (
            ["train", "--sampler", "mixture", "--sampler.share=2"],
            "share is 2.0; it must be a number from 0 to 1",
        ),
        (["study", "--sampler.alpha", "1"], "a study tries its samplers' numbers; give --samplers"),
        (["study", "--sampler", "pec"], "unknown option --sampler (did you mean --samplers?)"),
        (["study", "fig4", "--agent.num-minibatches", "5"], "5 minibatches do not divide 32 steps"),
    ],
)
def test_what_is_wrong_gets_one_line_and_leaves_nothing(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli.devices, "use_all_cores", lambda: None)
    monkeypatch.setattr(cli.devices, "keep_compiled_programs", lambda: None)
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert said in err and err.count("\n") == 1 and out == ""
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("words", "sampler"),
    [
        (["--sampler.sampler", "table_top", "--sampler.sampler.best=0.3"], Floor(TableTop(best=0.3))),
        (["--sampler.sampler=floor", "--sampler.sampler.sampler", "uniform"], Floor(Floor(Uniform()))),
        (["--sampler.epsilon", "0.5", "--sampler.sampler", "pec"], Floor(PEC(), 0.5)),
    ],
)
def test_samplers_within_samplers_are_chosen_by_path(words, sampler):
    base = replace(presets.find_preset(), sampler=Floor())
    assert settings_args.apply(base, words, Train).sampler == sampler


def test_a_study_shares_them_among_its_runs(tmp_path):
    command = cli.parse(["study", "fig4", "--agent.learning-rate", "0.5", "--evaluation.episodes", "9"])
    assert isinstance(command, Study)
    run = command._settings(tmp_path).run
    assert run.agent.learning_rate == 0.5 and run.evaluation.episodes == 9


def test_a_study_flies_what_its_maps_mark_and_else_set_1(tmp_path):
    def runs_of(*words):
        command = cli.parse(["study", *words])
        assert isinstance(command, Study)
        study = command._settings(tmp_path / "study")
        return [study.settings_of(spec) for specs in study.batches() for spec in specs]

    (tmp_path / "plan.txt").write_text("cell 1\n#######\n#S...G#\n#S...G#\n#######\n")
    marked = runs_of("--scene", str(tmp_path / "plan.txt"))
    assert {shown_space(space_name(run)) for run in marked} == {"plan"}
    assert {run.task.configurations().size for run in marked} == {4}
    assert {shown_space(space_name(run)) for run in runs_of()} == {"set 1"}


@pytest.mark.parametrize("command", ["train", "study"])
def test_help_lists_every_setting(command, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.parse([command, "--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    for path in settable("ppo"):
        if command == "train" or not path.startswith("sampler"):
            assert "--" + path.replace("_", "-") in out, path


def test_help_is_of_the_kinds_that_are_named(capsys):
    with pytest.raises(SystemExit):
        cli.parse(["train", "--sampler=floor", "--sampler.sampler", "table_top", "--agent", "apex", "--help"])
    out = capsys.readouterr().out
    for option in ("--sampler.epsilon", "--sampler.sampler.best", "--agent.replay.capacity"):
        assert option in out
    assert "--sampler.alpha" not in out and "--agent.clip-epsilon" not in out
