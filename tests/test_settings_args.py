"""Settings on the command line: every leaf by its path, and what is wrong in one line."""

import contextlib
import typing
from pathlib import Path

import pytest

from pecjax import cli, settings_tree
from pecjax.commands import settings_args, train
from pecjax.commands.study import Study
from pecjax.commands.train import Train
from pecjax.training import presets

OF_TRAIN = {
    "preset",
    "algorithm",
    "coordinates",
    "scene",
    "seed",
    "iterations",
    "until_goal_ratio",
    "patience",
}


def settable(algorithm):
    """The paths that have no option of their own, with their values."""
    other = {"ppo": "apex.", "apex": "ppo."}[algorithm]
    return {
        path: value
        for path, value in settings_tree.leaves(presets.find_preset(algorithm=algorithm))
        if path not in OF_TRAIN and not path.startswith(other)
    }


def another(algorithm, path, value):
    """Some other value that the leaf may have."""
    tree = presets.find_preset(algorithm=algorithm)
    *parents, name = path.split(".")
    for parent in parents:
        tree = getattr(tree, parent)
    choices = typing.get_args(typing.get_type_hints(type(tree))[name])
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return next(choice for choice in choices if choice != value)
    if isinstance(value, tuple):
        return (*value, 7)
    if value is None:
        return (20, 10) if name == "resolution" else 3
    return value + 1


def words_for(path, value):
    option = "--" + path.replace("_", "-")
    if isinstance(value, bool):
        parent, _, name = option.removeprefix("--").rpartition(".")
        return [option] if value else [f"--{parent}{'.' * bool(parent)}no-{name}"]
    return [option, *map(str, value if isinstance(value, tuple) else (value,))]


CASES = [(algorithm, path) for algorithm in ("ppo", "apex") for path in settable(algorithm)]


@pytest.mark.parametrize(("algorithm", "path"), CASES, ids=lambda case: case)
def test_every_leaf_can_be_set(algorithm, path):
    """As `set_path` does, which is tested by itself."""
    value = another(algorithm, path, settable(algorithm)[path])
    kept, settings = settings_args.split(
        ["train", "--seed", "3", *words_for(path, value), "--out", "x"], Train
    )
    assert kept == ["train", "--seed", "3", "--out", "x"]
    base = presets.find_preset(algorithm=algorithm)
    found = settings_args.apply(base, settings, Train)
    assert found == settings_tree.set_path(base, path, value) != base


def test_none_can_be_said(monkeypatch):
    found = run_with(monkeypatch, "--ppo.max-grad-norm", "none", "--ppo.kl-coeff", "0.2")
    assert found.ppo.max_grad_norm is None and found.ppo.kl_coeff == 0.2


def run_with(monkeypatch, *words):
    """The settings that a training would be begun with."""
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
        monkeypatch, "--preset", "rllib085", "--sampler.alpha", "0.7", "--ppo.network.hidden", "8", "9",
        "--evaluate-every=7", "--num-envs", "50", "--no-greedy",
    )  # fmt: skip
    wanted = presets.find_preset("rllib085")
    for path, value in (
        ("sampler.alpha", 0.7),
        ("ppo.network.hidden", (8, 9)),
        ("evaluate_every", 7),
        ("ppo.num_envs", 50),
        ("greedy", False),
    ):
        wanted = settings_tree.set_path(wanted, path, value)
    assert found == wanted


def test_the_numbers_are_those_of_the_sampler_that_is_named(monkeypatch):
    named = "test_settings_tree:Learnability"
    found = run_with(monkeypatch, "--sampler", named, "--sampler.floor", "0.3")
    assert settings_tree.to_json(found)["sampler"] == {"kind": named, "floor": 0.3, "power": 1.0}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["train", "--sampler.alhpa", "1"], "unknown option --sampler.alhpa (did you mean --sampler.alpha?)"),
        (["train", "--sampler", "uniform", "--sampler.alpha", "1"], "unknown option --sampler.alpha"),
        (["train", "--ppo.shuffle", "stps"], "invalid choice 'stps' for argument '--ppo.shuffle'"),
        (["train", "--ppo.num-envs", "many"], "--ppo.num-envs takes a whole number, not 'many'"),
        (["train", "--ppo.clip", "much"], "--ppo.clip takes a number, not 'much'"),
        (["train", "--ppo.clip"], "Missing value for argument '--ppo.clip'"),
        (["train", "--apex.batch-size", "8"], "unknown option --apex.batch-size"),
        (["train", "--ppo.num-minibatches", "5"], "5 minibatches do not divide 32 steps"),
        (["train", "--sampler.alpha", "-1"], "alpha is -1"),
        (["train", "--ppo.clip", "nan"], "clip is nan"),
        (["study", "--sampler.alpha", "1"], "a study tries its samplers' numbers; give --samplers"),
        (["study", "--sampler", "pec"], "unknown option --sampler (did you mean --samplers?)"),
        (["study", "fig4", "--ppo.num-minibatches", "5"], "5 minibatches do not divide 32 steps"),
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


def test_a_study_shares_them_among_its_runs(tmp_path):
    command = cli.parse(["study", "fig4", "--ppo.learning-rate", "0.5", "--evaluation-episodes", "9"])
    assert isinstance(command, Study)
    run = command._settings(tmp_path).run
    assert run.ppo.learning_rate == 0.5 and run.evaluation_episodes == 9


@pytest.mark.parametrize("command", ["train", "study"])
def test_help_lists_every_setting(command, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.parse([command, "--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    for path in settable("ppo"):
        if command == "train" or not path.startswith("sampler"):
            assert "--" + path.replace("_", "-") in out, path
