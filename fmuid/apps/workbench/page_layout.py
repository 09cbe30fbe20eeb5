"""Frame of all pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any

from bokeh import __version__ as bokeh_version
from bokeh.core.validation import silence
from bokeh.core.validation.warnings import EMPTY_LAYOUT
from jinja2 import Environment, Template
from markupsafe import Markup

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.reports.render.html import page_file

silence(EMPTY_LAYOUT)  # parts of a page that come later


@cache
def template() -> Template:
    """Return the template of every page; ``pieces`` are HTML, each with the name of the Bokeh root after it."""
    return Environment(autoescape=True).from_string(own_file("shell.html"))


def own_file(name: str) -> str:
    """Return a file of the workbench."""
    return resources.files("fmuid.apps.workbench").joinpath(name).read_text(encoding="utf-8")


@cache
def style() -> str:
    """Return the style of all pages: that of a report, and more."""
    return page_file("page.css") + own_file("workbench.css")


def variables(
    title: str, pieces: Sequence[tuple[str, str]], scheme: str, libraries: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the template's variables of a page; `libraries` are those of Bokeh, as ``bokeh-widgets``."""
    sources = [f"/static/js/{name}.min.js?v={bokeh_version}" for name in libraries]
    marked = [(Markup(html), root) for html, root in pieces]
    return {"title": title, "pieces": marked, "scheme": scheme, "libraries": sources}


def arguments(doc: Any, name: str) -> list[str]:
    """Return all values of an argument of a page's address."""
    request = None if doc.session_context is None else doc.session_context.request
    given = {} if request is None else request.arguments
    return [each.decode("utf-8", "replace") for each in given.get(name, [])]


def argument(doc: Any, name: str) -> str:
    """Return the last value of an address's argument, or ""."""
    return (arguments(doc, name) or [""])[-1]


def dress(doc: Any, title: str, pieces: Sequence[tuple[str, str]], *libraries: str) -> None:
    """Show a document as a page; `libraries` are those beside ``bokeh``."""
    scheme = argument(doc, SCHEME) or "light"
    doc.title, doc.template = title, template()
    doc.config.update(reconnect_session=False, notify_connection_status=False)  # the page's script handles it
    doc.template_variables.update(variables(title, pieces, scheme, ("bokeh", *libraries)))


def sections(doc: Any, roots: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Add roots to a document; return a section for each, below its HTML."""
    pieces = []
    for head, root in roots.items():
        doc.add_root(root)
        pieces += [(f"<section>{head}", str(root.name)), ("</section>", "")]
    return pieces
