"""What all pages have: head, way back, look; and how their parts stand in them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

from bokeh import __version__ as bokeh_version
from jinja2 import Environment, Template
from markupsafe import Markup

from fmuid.workbench.access import SCHEME

Crumbs = Sequence[tuple[str, str]]
"""Where a page is: texts and addresses, from the folder on."""


@cache
def template() -> Template:
    """Return the template of every page.

    Its variables are texts, escaped there, but for ``pieces``: HTML of ours, each with the name of the Bokeh root that
    follows it, or "".
    """
    return Environment(autoescape=True).from_string(own_file("shell.html"))


def own_file(name: str) -> str:
    """Return a file of the workbench."""
    return resources.files("fmuid.workbench").joinpath(name).read_text(encoding="utf-8")


@cache
def style() -> str:
    """Return the style of all pages, which begins with that of a report."""
    report = resources.files("fmuid.reports.page").joinpath("page.css").read_text(encoding="utf-8")
    return report + own_file("workbench.css")


def variables(
    title: str, pieces: Sequence[tuple[str, str]], crumbs: Crumbs, scheme: str, libraries: Sequence[str] = ()
) -> dict[str, Any]:
    """Return what the template needs.

    Parameters
    ----------
    title : str
    pieces : sequence of (str, str)
    crumbs : sequence of (str, str)
    scheme : "light" or "dark"
        In which it is drawn.
    libraries : sequence of str
        Of Bokeh, as ``bokeh-widgets``.
    """
    sources = [f"/static/js/{name}.min.js?v={bokeh_version}" for name in libraries]
    marked = [(Markup(html), root) for html, root in pieces]
    return {"title": title, "pieces": marked, "crumbs": crumbs, "scheme": scheme, "libraries": sources}


def arguments(doc: Any, name: str) -> list[str]:
    """Return all that the address of a page says under a name."""
    request = None if doc.session_context is None else doc.session_context.request
    given = {} if request is None else request.arguments
    return [each.decode("utf-8", "replace") for each in given.get(name, [])]


def argument(doc: Any, name: str) -> str:
    """Return what the address of a page says under a name, "" for nothing."""
    return (arguments(doc, name) or [""])[-1]


def dress(doc: Any, title: str, pieces: Sequence[tuple[str, str]], crumbs: Crumbs, *libraries: str) -> None:
    """Have a document shown as a page of ours.

    Parameters
    ----------
    doc : Document
    title, pieces, crumbs
        As for `variables`.
    *libraries : str
        Of Bokeh, besides ``bokeh``.
    """
    scheme = argument(doc, SCHEME) or "light"
    doc.title, doc.template = title, template()
    doc.template_variables.update(variables(title, pieces, crumbs, scheme, ("bokeh", *libraries)))
