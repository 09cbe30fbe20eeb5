"""How Sphinx makes a site of the pages: ``python -m sphinx -nW --keep-going -c docs . build/site``.

It reads the whole repository, so that a link between pages is the same here, in an editor and in a repository.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from fmuid.version import __version__ as release

ROOT = Path(__file__).parents[1]

project, author, copyright = "fmuid", "the authors of fmuid", "the authors of fmuid; BSD-3-Clause"
version = release

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx-mathjax-offline",  # the site asks no other host
]
root_doc = "docs/index"
include_patterns = [
    "docs/**.md",
    "docs/api/**.rst",
    "experiments/**.md",
    "fmus/**.md",
    "fmuid/export/README.md",
    "fmuid/simulation/native/README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
]
nitpicky = True
# Types in docstrings are words for people; what is called by its public name, fmuid.Name, must have its page.
nitpick_ignore_regex = [(r"py:.*", r"(?!fmuid\.\w+$).*"), ("py:obj", "fmuid.events")]

myst_enable_extensions = ["attrs_inline", "colon_fence", "dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings say the types
napoleon_google_docstring = False
napoleon_use_ivar = True
default_role = "autolink"

html_theme = "furo"
html_title = "fmuid"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_additional_pages = {"index": "start.html"}
templates_path = ["templates"]
html_copy_source = False
html_show_sphinx = False


def linked(page: Path, text: str) -> str:
    """Return a page whose links to folders lead to their README.md, where they have one; a bare table is in no menu."""

    def replaced(link: re.Match[str]) -> str:
        words, target = link.groups()
        folder = page.parent / target
        if not folder.is_dir():
            return link[0]
        return f"[{words}]({target.rstrip('/')}/README.md)" if (folder / "README.md").exists() else words

    head = "---\norphan: true\n---\n" if text.startswith("|") else ""
    return head + re.sub(r"(?<!!)\[([^\[\]]*)\]\(([^()#:\s]+)\)", replaced, text)


def setup(app: Any) -> None:
    """Have links to folders read as links to their pages."""
    app.connect("source-read", lambda _, name, source: source.__setitem__(0, linked(ROOT / f"{name}.md", source[0])))
