"""Trees of settings: dotted paths, kinds by address, and JSON that reads back as what was written."""

import json
import sys
from dataclasses import dataclass, replace

import pytest
from jax import numpy as jnp

from pecjax import InputError, settings_tree
from pecjax.agents import PPO, AgentSettings, Apex
from pecjax.curriculum import PEC, SamplerSettings, Uniform, from_counts
from pecjax.envs.rooms.controller import ControllerGains
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.task import TaskSettings
from pecjax.training.kinds import has_alpha, kind_name, label, make_kind, sampler_label
from pecjax.training.presets import PRESETS
from pecjax.training.settings import RunSettings

CURRICULUM = "pecjax.curriculum"


@dataclass(frozen=True)
class Learnability(SamplerSettings):
    floor: float = 0.05
    power: float = 1.0

    def make(self, num_configs):
        def priority(trials, failures, numbers):
            p = failures / jnp.maximum(trials, 1)
            return (p * (1 - p)) ** numbers["power"] + numbers["floor"]

        return from_counts(num_configs, {"floor": self.floor, "power": self.power}, priority)


@dataclass(frozen=True)
class Unfinished(SamplerSettings):
    floor: float = 0.05


@dataclass(frozen=True)
class Demanding(SamplerSettings):
    floor: float

    def make(self, num_configs):
        raise AssertionError


@dataclass(frozen=True)
class WindyRooms(Rooms):
    wind: float = 2.0


@dataclass(frozen=True)
class Patient(PPO):
    patience: int = 3


OWN = f"{__name__}:Learnability"
RUNS = {
    **PRESETS,
    "own": RunSettings(sampler=Learnability(floor=0.1)),
    "uniform": RunSettings(sampler=Uniform(), task=Rooms(resolution=(20, 10), maps=("a.xml", "b"))),
    "own kinds of all": RunSettings(
        task=WindyRooms(wind=3.0, gains=ControllerGains(height=2.0)), sampler=Learnability(), agent=Patient()
    ),
}


@pytest.mark.parametrize("name", RUNS)
def test_a_tree_reads_back_from_json_as_it_was(name):
    content = json.loads(json.dumps(settings_tree.to_json(RUNS[name])))
    assert settings_tree.from_json(content, RunSettings) == RUNS[name]
    assert list(settings_tree.differences(content, settings_tree.to_json(RUNS[name]))) == []


def test_json_has_every_leaf_and_the_address_of_a_kind():
    content = settings_tree.to_json(RUNS["own"])
    assert content["sampler"] == {"kind": OWN, "floor": 0.1, "power": 1.0}
    assert content["agent"]["kind"] == "pecjax.agents.ppo.settings:PPO"
    assert content["task"]["kind"] == "pecjax.envs.rooms.settings:Rooms"
    for part in (content["agent"]["network"], content["task"]["gains"], content["stop"]):
        assert "kind" not in part  # which can be of one kind only
    for path, value in settings_tree.leaves(RUNS["own"]):
        found = content
        for name in path.split("."):
            found = found[name]
        assert found == (list(value) if isinstance(value, tuple) else value)


def test_differences_have_paths_and_both_values():
    before = settings_tree.to_json(RUNS["own"])
    now = settings_tree.to_json(replace(RUNS["own"], sampler=Learnability(floor=0.2), seed=4))
    found = list(settings_tree.differences(before, now))
    assert found == ["sampler.floor (0.1 there, 0.2 here)", "seed (0 there, 4 here)"]
    # Whatever a stranger's file holds, a difference can be read.
    (found,) = settings_tree.differences({"seed": "7" * 10**6}, {"seed": 7})
    assert found.startswith("seed ('777") and found.endswith("… there, 7 here)") and len(found) < 200


@pytest.mark.parametrize(
    ("path", "value", "found"),
    [
        ("seed", 3, 3),
        ("sampler.alpha", 0.3, 0.3),
        ("sampler.alpha", "0.3", 0.3),  # as a command line has it
        ("agent.network.hidden", [8, 8], (8, 8)),
        ("stop.until_goal_ratio", 0.9, 0.9),
        ("stop.until_goal_ratio", None, None),
        ("evaluation.greedy", "false", False),
        ("task.resolution", [20, 10], (20, 10)),
        ("task.maps", ["a.xml"], ("a.xml",)),
        ("task.goal_radius", 1, 1.0),
        ("seed", 3.0, 3),
    ],
)
def test_any_leaf_can_be_set_and_nothing_else_changes(path, value, found):
    before, after = RunSettings(), settings_tree.set_path(RunSettings(), path, value)
    assert dict(settings_tree.leaves(after)) == dict(settings_tree.leaves(before)) | {path: found}
    assert before == RunSettings()


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("sampler.alhpa", 1, r"no setting sampler.alhpa \(did you mean alpha\?\); of PEC there are alpha"),
        ("sedd", 1, r"no setting sedd \(did you mean seed\?\)"),
        ("seed.more", 1, "no setting seed.more; of int it has no settings"),
        ("sampler.alpha", "much", "sampler.alpha is 'much'; it takes float"),
        ("agent.num_envs", "many", "agent.num_envs is 'many'; it takes int"),
        ("agent.num_envs", 1.5, "agent.num_envs is 1.5; it takes int"),
        ("evaluation.greedy", "no", "evaluation.greedy is 'no'; it takes bool"),
        ("agent.network.hidden", "64", r"agent.network.hidden is '64'; it takes tuple"),
        ("task.resolution", "20", "task.resolution is '20'; it takes tuple"),
        ("agent.replay.capacity", 1, "no setting agent.replay.capacity; of PPO there are num_envs"),
        ("task.goal_radus", 1, r"no setting task.goal_radus \(did you mean goal_radius\?\); of Rooms"),
    ],
)
def test_paths_that_lead_nowhere_and_values_of_another_type(path, value, words):
    with pytest.raises(InputError, match=words):
        settings_tree.set_path(RunSettings(), path, value)


class Entry:
    name, value = "plugged_in", OWN


def test_kinds_by_module_by_address_and_by_entry_point(monkeypatch):
    resolve = settings_tree.resolve
    assert resolve("pec", SamplerSettings, CURRICULUM) is PEC
    assert resolve("uniform", SamplerSettings, CURRICULUM) is Uniform
    assert resolve(OWN, SamplerSettings, CURRICULUM) is Learnability
    groups = {CURRICULUM: [Entry]}
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: groups.get(group, []))
    assert resolve("plugged_in", SamplerSettings, CURRICULUM) is Learnability
    assert settings_tree.short_name(PEC, CURRICULUM) == "pec"
    assert settings_tree.short_name(Learnability, CURRICULUM) == OWN
    # A package within the package is a kind's module too.
    assert resolve("ppo", AgentSettings, "pecjax.agents") is PPO
    assert resolve("apex", AgentSettings, "pecjax.agents") is Apex
    assert resolve("rooms", TaskSettings, "pecjax.envs") is Rooms
    found = [kind_name(value) for value in (PPO(), Apex(), Rooms(), PEC(), Patient(), WindyRooms())]
    own = [f"{__name__}:Patient", f"{__name__}:WindyRooms"]
    assert found == ["ppo", "apex", "rooms", "pec", *own]
    assert [type(make_kind(*pair)) for pair in (("agent", own[0]), ("task", own[1]))] == [Patient, WindyRooms]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "pex",
            r"unknown sampler 'pex' \(did you mean pec\?\); choose one of dro, .*, uniform, or .*:Class",
        ),
        ("base", "unknown sampler 'base'"),
        ("no.such.module:Sampler", "no.such.module:Sampler: cannot be imported .*ModuleNotFoundError"),
        (f"{__name__}:Nothing", "cannot be imported .*AttributeError"),
        (":", "cannot be imported"),
        ("json:JSONDecoder", "json:JSONDecoder: is no SamplerSettings"),
        ("pecjax.curriculum:pec", "is no SamplerSettings"),
        (f"{__name__}:Unfinished", "Unfinished: lacks make; define it"),
        (f"{__name__}:Demanding", "floor.*give every setting a default"),
    ],
)
def test_samplers_that_cannot_be_had(name, words):
    with pytest.raises(InputError, match=words) as error:
        make_kind("sampler", name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("slot", "name", "words"),
    [
        ("agent", "pp", r"unknown agent 'pp' \(did you mean ppo\?\); choose one of apex, ppo, or .*:Class"),
        ("agent", "base", "unknown agent 'base'"),
        ("agent", OWN, "is no AgentSettings"),
        ("task", "room", r"unknown task 'room' \(did you mean rooms\?\); choose one of .*rooms"),
        ("task", "pecjax.agents:PPO", "is no TaskSettings"),
    ],
)
def test_agents_and_tasks_that_cannot_be_had(slot, name, words):
    with pytest.raises(InputError, match=words):
        make_kind(slot, name)


def test_modules_that_need_an_extra_are_passed_over(monkeypatch):
    for library, module in [("gymnax", "as_gymnax"), ("gymnasium", "as_gymnasium")]:
        monkeypatch.setitem(sys.modules, library, None)  # as if it were not installed
        monkeypatch.delitem(sys.modules, f"pecjax.envs.{module}", raising=False)
    with pytest.raises(
        InputError, match=r"unknown task 'room' \(did you mean rooms\?\); choose one of rooms, or"
    ):
        make_kind("task", "room")


def test_a_module_that_fails_when_it_is_imported(tmp_path, monkeypatch):
    (tmp_path / "failing.py").write_text("1 / 0\n")
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    with pytest.raises(InputError, match=r"failing:Sampler: cannot be imported \(ZeroDivisionError"):
        make_kind("sampler", "failing:Sampler")


@pytest.mark.parametrize(
    ("sampler", "words"),
    [
        ({"kind": "no.module:Sampler"}, "cannot be imported"),
        ({"kind": "json:JSONDecoder"}, "is no SamplerSettings"),
        ({"kind": OWN, "flor": 1.0}, r"has no setting flor \(did you mean floor\?\)"),
    ],
)
def test_json_that_names_what_cannot_be_had(sampler, words):
    content = settings_tree.to_json(RunSettings()) | {"sampler": sampler}
    with pytest.raises(InputError, match=words):
        settings_tree.from_json(content, RunSettings)


def test_a_sampler_keeps_its_numbers_when_it_is_named_again():
    assert make_kind("sampler", "pec", like=PEC(0.7)) == PEC(0.7)
    assert make_kind("sampler", "pec", like=Uniform()) == PEC()
    assert sampler_label(PEC(1.0)) == "pec (α = 1)" and sampler_label(Uniform()) == "uniform"
    assert has_alpha(PEC()) and not has_alpha(Learnability())
    # Of a path and of an address, people are shown the end.
    assert sampler_label(Learnability(floor=0.125)) == "Learnability (floor = 0.125, power = 1)"
    assert label("pec", [("sampler.alpha", 0.5), ("agent.num_envs", 8)]) == ["pec", "α = 0.5", "num_envs = 8"]
