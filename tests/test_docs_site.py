"""The docs site: it builds without a warning, loads nothing from the network, and has no broken links."""

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

import pecjax
from pecjax import curriculum

DOCS = Path(__file__).parents[1] / "docs"
ELSEWHERE = ("http:", "https:", "//", "mailto:")


class Page(HTMLParser):
    """A page's title, the anchors in it, what it links to, and what it loads."""

    def __init__(self, text):
        super().__init__()
        self.title, self.anchors, self.links, self.loads = "", set(), [], []
        self._in_title = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self._in_title = self._in_title or (tag == "title" and not self.title)
        for name, value in attrs:
            if name in ("id", "name"):
                self.anchors.add(value)
            elif name == "href" and tag == "a":
                self.links.append(value)
            elif name in ("href", "src", "srcset", "data", "poster") and value:
                self.loads.append(value)

    def handle_endtag(self, tag):
        self._in_title = self._in_title and tag != "title"

    def handle_data(self, data):
        self.title += data if self._in_title else ""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built site."""
    for library in ("sphinx", "myst_nb", "sphinx_book_theme", "sphinx_copybutton"):
        pytest.importorskip(library)
    out = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet", DOCS, out],
        capture_output=True,
        text=True,
    )
    assert (built.returncode, built.stderr) == (0, "")
    return out


@pytest.fixture(scope="module")
def pages(site):
    """Every page by its path."""
    return {path: Page(path.read_text()) for path in site.rglob("*.html") if "_static" not in path.parts}


@pytest.mark.slow
def test_every_page_has_a_title_and_loads_nothing_from_the_network(site, pages):
    for path, page in pages.items():
        assert page.title.strip(), path
        assert not [target for target in page.loads if target.startswith(ELSEWHERE)], path
    for path in site.rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//", path.read_text()), path
    assert len(pages) >= 20


@pytest.mark.slow
def test_links_within_the_site_lead_somewhere(pages):
    for path, page in pages.items():
        for link in page.links:
            if link.startswith(ELSEWHERE):
                assert urlsplit(link).netloc, (path, link)
                continue
            target, anchor = unquote(urlsplit(link).path), unquote(urlsplit(link).fragment)
            there = (path.parent / target).resolve() if target else path
            assert there.exists(), (path, link)
            assert not anchor or anchor in pages[there].anchors, (path, link)


@pytest.mark.slow
def test_every_public_name_is_in_the_reference(pages):
    anchors = set().union(*(page.anchors for page in pages.values()))
    public = {f"pecjax.{name}" for name in pecjax._NAMES}
    public |= {f"pecjax.curriculum.{name}" for name, value in vars(curriculum).items() if callable(value)}
    assert sorted(public - anchors - {"pecjax.Task", "pecjax.TaskSettings"}) == []


def run_page(name):
    """The names that are there after a page's Python."""
    names = {}
    for block in re.findall(r"```python\n(.*?)```", (DOCS / name).read_text(), re.DOTALL):
        exec(block, names)
    return names


def test_the_concepts_draw_and_count():
    names = run_page("concepts.md")
    assert names["ids"].shape == (8,)
    chances = names["sampler"].probabilities(names["state"])
    np.testing.assert_allclose(chances, [0.75, 0.125, 0.125], rtol=1e-6)


@pytest.mark.slow
def test_the_quickstart_trains():
    result = run_page("quickstart.md")["result"]
    assert result.summary["iterations"] == 3 and 0 <= result.evaluation[-1]["goal_ratio"] <= 1
