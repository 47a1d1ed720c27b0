"""docs/samplers.md says of every sampler what the code does, and its pictures are of that code."""

import dataclasses
import importlib.util
import inspect
import pkgutil
import re
from pathlib import Path

import jax
import numpy as np
import pytest

from pecjax import curriculum, settings_tree
from pecjax.curriculum import SamplerSettings

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "samplers.md").read_text()
SECTIONS = dict(re.findall(r"^### `(\w+)`\n(.*?)(?=^##|\Z)", PAGE, re.DOTALL | re.MULTILINE))


def all_kinds():
    """Every kind of sampler that the package defines, by its name."""
    package = "pecjax.curriculum"
    found = {}
    for about in pkgutil.iter_modules(curriculum.__path__):
        if about.ispkg:  # what needs other libraries
            continue
        defined = vars(importlib.import_module(f"{package}.{about.name}")).values()
        for kind in filter(inspect.isclass, defined):
            if issubclass(kind, SamplerSettings) and not inspect.isabstract(kind):
                found[settings_tree.short_name(kind, package)] = kind
    return found


KINDS = all_kinds()
WITHIN = {"floor", "mixture", "per_step"}  # out of other samplers


@pytest.fixture(scope="module")
def pictures():
    """The program that draws them."""
    about = importlib.util.spec_from_file_location("sampler_pictures", DOCS / "sampler_pictures.py")
    module = importlib.util.module_from_spec(about)
    about.loader.exec_module(module)
    return module


def rows(first):
    """The rows of the table whose header begins so: names and the other cells."""
    lines = PAGE[PAGE.index(f"| {first} |") :].split("\n\n")[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {name.strip("`"): rest for name, *rest in cells}


def test_every_sampler_has_a_section_a_row_and_a_picture(pictures):
    assert set(SECTIONS) == {*KINDS, "by_group"} == set(rows("name"))
    assert set(pictures.NAMES) == set(KINDS) - WITHIN == set(rows("sampler"))
    for name in pictures.NAMES:
        assert f"![{name}](images/samplers/{name}.png)" in SECTIONS[name]
    shown = re.findall(r"\]\((images/[^)]*)\)", PAGE)
    assert {path.name for path in (DOCS / "images" / "samplers").iterdir()} == {Path(p).name for p in shown}


@pytest.mark.parametrize("name", KINDS)
def test_the_numbers_are_those_of_the_code(name):
    line = re.search(r"^Numbers: (.*?)\n\n", SECTIONS[name], re.DOTALL | re.MULTILINE)[1]
    stated = dict(re.findall(r"`(\w+) = ([^`]*)`", line))
    values = {field.name: getattr(KINDS[name](), field.name) for field in dataclasses.fields(KINDS[name])}
    expected = {
        key: settings_tree.short_name(type(value), "pecjax.curriculum")
        if isinstance(value, SamplerSettings)
        else f"{value:g}" if isinstance(value, float) else f"{value}"
        for key, value in values.items()
    }  # fmt: skip
    assert stated == expected and (expected or line == "none.")


@pytest.mark.parametrize("name", KINDS)
def test_the_bytes_are_those_of_the_state(name):
    def size(kind, number):
        state = jax.eval_shape(kind.make(number).init)
        return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(state))

    def of_each(kind):
        return size(kind, 101) - size(kind, 100)

    kind, (stated, *others) = KINDS[name](), rows("name")[name][2].split(", by ")
    for choice, more in (re.fullmatch(r"`(\w+)` (\d+)", other).groups() for other in others):
        assert of_each(KINDS[name](score=choice)) == int(more)
    inner = [value for value in vars(kind).values() if isinstance(value, SamplerSettings)]
    further = of_each(kind) - sum(map(of_each, inner))
    assert stated == {"mixture": "both", "floor": "+ 0"}.get(name, f"{'+ ' * bool(inner)}{further}")
    assert further == 0 or name not in ("mixture", "floor")


def test_the_pages_python_runs(capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names = {}
    for block in blocks:
        exec(block, names)
    assert len(blocks) == 6 and capsys.readouterr().out == "(3, 20)\n"
    assert names["settings"].sampler == curriculum.TableTop(tries=2.0, best=0.2)
    assert names["groups"].shape == (100_000,) and names["groups"].max() == 63
    np.testing.assert_array_equal(names["state"].statistics[0], np.arange(20) < 8)
    assert isinstance(names["FlooredTop"]().make(5), curriculum.Sampler)


@pytest.fixture(scope="module")
def history(pictures):
    return pictures.simulate()


def test_all_hear_the_history_that_the_page_tells_of(pictures, history):
    assert history.outcomes.failed.shape == (200, 20) and history.chance.shape == (200, 40)
    place = np.argsort(history.ids)[history.outcomes.config_id]
    failed = np.asarray(history.outcomes.failed)
    assert not failed[place < pictures.SOLVED].any() and failed[place >= 40 - pictures.FAILED].all()
    expected = np.take_along_axis(history.chance, place, axis=1)
    within = np.sqrt((expected * (1 - expected)).sum())
    assert abs((~failed).sum() - expected.sum()) < 4 * within
    np.testing.assert_allclose(history.outcomes.signal, np.where(failed, 0, 1 - expected), atol=1e-6)


@pytest.mark.parametrize("name", [name for name in KINDS if name not in WITHIN])
def test_the_draws_go_where_the_page_says(pictures, history, name):
    """To half a unit of the last digit that it gives, and a little for what rounding does to a threshold."""
    share = pictures.shares(KINDS[name](), history)
    np.testing.assert_allclose(share.mean(axis=1), 1, rtol=1e-4)
    stated = np.array(rows("sampler")[name], float)
    assert np.all(np.abs(pictures.summary(share, history.chance) - stated) < [0.007, 0.007, 0.007, 0.7])


def test_a_picture_is_drawn_of_whatever_is_named(pictures, tmp_path, capsys):
    pictures.main(["pec", "pecjax.curriculum.floor:Floor", "--out", str(tmp_path)])
    assert {path.name for path in tmp_path.iterdir()} == {"pec.png", "Floor.png", "all.png", "history.png"}
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] in PAGE and printed[1].startswith("| `pecjax.curriculum.floor:Floor` |")
