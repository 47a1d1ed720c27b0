"""The docs site: `make docs` builds it into docs/_build/html. Its pages load nothing from the network."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

from sphinx.application import Sphinx

import pecjax

project = author = "pecjax"
project_copyright = "the authors of pecjax"
version = release = pecjax.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["_build", "results"]  # tables, of which pages include some
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"(?!pecjax\b).*"),  # the documentation of others is on the network
    (r"py:class", r"pecjax\.[\w.]*\.(T|Table|Self)"),  # type variables
]

myst_heading_anchors = 3
nb_execution_mode = "off"  # the tutorials are shown as they were stored; the tests run them
nb_ipywidgets_js = {}
nb_merge_streams = True  # the lines of a log as one output

default_role = "code"  # docstrings write names in single backticks
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_mock_imports = [name for name in ("gymnasium", "gymnax") if find_spec(name) is None]
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
maximum_signature_line_length = 88
napoleon_custom_sections = [("Attributes", "params_style")]  # else "Variables", and two of one line apart
napoleon_attr_annotations = False  # the signature has them

html_theme = "sphinx_book_theme"
html_title = "pecjax"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "use_fullscreen_button": False,
    "use_download_button": False,
    "footer_content_items": ["copyright.html"],
}


def outputs_within(model: str, states: dict[str, Any]) -> Iterator[Any]:
    """The outputs that a stored widget shows, in order."""
    state = states[model]["state"]
    yield from state.get("outputs", ())
    for child in state.get("children", ()):
        yield from outputs_within(child.removeprefix("IPY_MODEL_"), states)


def still_widgets(app: Sphinx, page: str, source: list[str]) -> None:
    """Puts what a widget last showed in its place: a page has no kernel to answer it."""
    if not page.startswith("tutorials/"):
        return
    notebook, kind = json.loads(source[0]), "application/vnd.jupyter.widget-view+json"
    stored = notebook["metadata"].get("widgets", {}).get("application/vnd.jupyter.widget-state+json", {})
    states = stored.get("state", {})
    for cell in notebook["cells"]:
        shown = []
        for output in cell.get("outputs", ()):
            model = output.get("data", {}).get(kind, {}).get("model_id")
            shown += outputs_within(model, states) if model in states else [output]
        if "outputs" in cell:
            cell["outputs"] = shown
    source[0] = json.dumps(notebook)


def skip_member(app: Sphinx, what: str, name: str, member: Any, skip: bool, options: Any) -> bool | None:
    """Leaves out the fields of named tuples: their "Attributes:" explain them."""
    return True if type(member).__name__ == "_tuplegetter" else None


def literal_blocks(app: Sphinx, what: str, name: str, member: Any, options: Any, lines: list[str]) -> None:
    """Marks formulas and examples as what they are: indented paragraphs that no section begins."""
    for place in reversed(range(1, len(lines))):
        before, line = lines[place - 1 : place + 1]
        if line.startswith("    ") and before == "Example:":
            lines[place - 1 : place] = ["Example::", ""]
        elif line.startswith("    ") and not before:
            lines[place:place] = ["::", ""]


def short_defaults(
    app: Sphinx, what: str, name: str, member: Any, options: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Shows a default that is an object as its constructor, without all its fields."""
    inner = r"(?:[^()]|\((?:[^()]|\([^()]*\))*\))*"
    return signature and re.sub(rf"= ([A-Z]\w*)\({inner}\)", r"= \1()", signature), returns


def setup(app: Sphinx) -> None:
    """Connects the hooks above."""
    app.connect("source-read", still_widgets)
    app.connect("autodoc-skip-member", skip_member)
    app.connect("autodoc-process-signature", short_defaults)
    app.connect("autodoc-process-docstring", literal_blocks, priority=100)  # before napoleon's
