"""benchmarks/race.py: racers that need nobody else's code train for a stretch and are looked at."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

FILE = Path(__file__).parents[1] / "benchmarks" / "race.py"
SPEC = importlib.util.spec_from_file_location("race", FILE)
race = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(race)


@pytest.mark.slow
@pytest.mark.parametrize("racer", ["pecjax", "told", "apex", "purejax"])
def test_a_racer_runs(racer):
    settings = race.settings_of(racer, {})
    found = race.in_process(racer, "1", 0, settings, limit=0)
    assert found["steps"] == 131_072 and found["reached"] == {}
    assert 0 <= found["last"] < 0.95
    assert found["training"] > 0


@pytest.mark.parametrize("words", [["--racers", "bracks"], ["--spaces", "3"]])
def test_a_mistaken_name_is_refused_before_the_search(words, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["race.py", *words])
    with pytest.raises(SystemExit):
        race.main()
    assert f"invalid choice: '{words[1]}'" in capsys.readouterr().err


def test_what_did_not_arrive_is_last(monkeypatch, capsys, tmp_path):
    """A median over seeds counts a run that reached no threshold as one that took for ever."""

    def run(name, space, seed, *others):
        seconds = {"pecjax": (1.0, 3.0, 2.0), "purejax": (4.0, None, None)}[name][seed]
        there = {"training": seconds, "whole": seconds, "steps": 100}
        return {"reached": {} if seconds is None else {"0.95": there, "0.97": there}}

    best = tmp_path / "best.json"
    best.write_text(json.dumps({name: {"settings": {}} for name in ("pecjax", "purejax")}))
    monkeypatch.setattr(race, "in_process", run)
    asked = ["--racers", "pecjax", "purejax", "--spaces", "1", "--best", str(best)]
    monkeypatch.setattr("sys.argv", ["race.py", *asked, "--out", str(tmp_path / "race.json")])
    race.main()
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if "reached it" in line]
    assert [line[:5] for line in lines[:2]] == [
        ["pecjax", "2.0", "2.0", "100", "3"], ["purejax", "inf", "inf", "inf", "1"]
    ]  # fmt: skip
    assert len(json.loads((tmp_path / "race.json").read_text())) == 6


def test_the_page_has_the_medians_of_the_second_race():
    docs = FILE.parents[1] / "docs"
    runs = json.loads((docs / "results" / "race-told.json").read_text())
    page = (docs / "performance.md").read_text()
    for label, racer in (
        ("pecjax, its defaults", "pecjax"),
        ("pecjax, critic told of paths", "told"),
        ("a loop like PureJaxRL's", "purejax"),
    ):
        cells = []
        for space, threshold, number in (("1", "0.97", 10), ("2", "0.97", 3), ("rooms-pairs", "0.9", 3)):
            there = [
                one["reached"][threshold] for one in runs if (one["racer"], one["space"]) == (racer, space)
            ]
            assert len(there) == number
            training, whole, steps = (
                np.median([one[kind] for one in there]) for kind in ("training", "whole", "steps")
            )
            cells += [f"{training:.1f}", f"{whole:.1f}", f"{steps / 1e6:.2f} M"]
        assert f"| {label} | {' | '.join(cells)} |" in page, label


def test_the_page_has_the_medians():
    """Every row of the table of performance.md, from the stored runs."""
    docs = FILE.parents[1] / "docs"
    stored = {
        name: json.loads((docs / "results" / f"race-{name}.json").read_text())
        for name in ("set1", "set2", "pairs", "defaults")
    }
    goals = (("1", "0.97", "set1"), ("2", "0.97", "set2"), ("rooms-pairs", "0.9", "pairs"))

    def cells(racer, source=None):
        for space, threshold, name in goals:
            there = [
                one["reached"].get(threshold)
                for one in stored[source or name]
                if (one["racer"], one["space"]) == (racer, space)
            ]
            assert len(there) == 3
            figures = [
                float(np.median([one[kind] if one else np.inf for one in there]))
                for kind in ("training", "whole", "steps")
            ]
            if np.isinf(figures[0]):
                yield from "–––"
            else:
                yield from (f"{figures[0]:.1f}", f"{figures[1]:.1f}", f"{figures[2] / 1e6:.2f} M")

    page = (docs / "performance.md").read_text()
    for label, *of in (
        ("pecjax, its defaults", "pecjax", "defaults"),
        ("pecjax, as the search has it", "pecjax"),
        ("a loop like PureJaxRL's", "purejax"),
        ("rejax 0.1.3", "rejax"),
        ("Brax PPO 0.14.2", "brax"),
        ("Stable-Baselines3 2.9.2, over C MuJoCo", "sb3"),
        ("pecjax, Ape-X", "apex"),
    ):
        assert f"| {label} | {' | '.join(cells(*of))} |" in page, label
