"""What all pages have: head, way back, look; how their parts stand in them, and the widgets that they share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from importlib import resources
from typing import Any

from bokeh import __version__ as bokeh_version
from bokeh.core.validation import silence
from bokeh.core.validation.warnings import EMPTY_LAYOUT
from bokeh.models import Button, Div, MultiSelect
from jinja2 import Environment, Template
from markupsafe import Markup

from fmuid.apps.workbench.access_control import SCHEME

silence(EMPTY_LAYOUT)  # parts of a page that are there later


@cache
def template() -> Template:
    """Return the template of every page.

    Its variables are texts, escaped there, but for ``pieces``: HTML of ours, each with the name of the Bokeh root that
    follows it, or "".
    """
    return Environment(autoescape=True).from_string(own_file("shell.html"))


def own_file(name: str) -> str:
    """Return a file of the workbench."""
    return resources.files("fmuid.apps.workbench").joinpath(name).read_text(encoding="utf-8")


SHEET = own_file("widgets.css")
"""Style of widgets, into which the page's own does not reach but for its variables."""


@cache
def style() -> str:
    """Return the style of all pages, which begins with that of a report."""
    report = resources.files("fmuid.reports.render").joinpath("page.css").read_text(encoding="utf-8")
    return report + own_file("workbench.css")


def variables(
    title: str, pieces: Sequence[tuple[str, str]], scheme: str, libraries: Sequence[str] = ()
) -> dict[str, Any]:
    """Return what the template needs besides ``home``, the name of the folder, where a page is not the first one.

    Parameters
    ----------
    title : str
    pieces : sequence of (str, str)
    scheme : "light" or "dark"
        In which it is drawn.
    libraries : sequence of str
        Of Bokeh, as ``bokeh-widgets``.
    """
    sources = [f"/static/js/{name}.min.js?v={bokeh_version}" for name in libraries]
    marked = [(Markup(html), root) for html, root in pieces]
    return {"title": title, "pieces": marked, "scheme": scheme, "libraries": sources}


def arguments(doc: Any, name: str) -> list[str]:
    """Return all that the address of a page says under a name."""
    request = None if doc.session_context is None else doc.session_context.request
    given = {} if request is None else request.arguments
    return [each.decode("utf-8", "replace") for each in given.get(name, [])]


def argument(doc: Any, name: str) -> str:
    """Return what the address of a page says under a name, "" for nothing."""
    return (arguments(doc, name) or [""])[-1]


def dress(doc: Any, title: str, pieces: Sequence[tuple[str, str]], *libraries: str) -> None:
    """Have a document shown as a page of ours.

    Parameters
    ----------
    doc : Document
    title, pieces
        As for `variables`.
    *libraries : str
        Of Bokeh, besides ``bokeh``.
    """
    scheme = argument(doc, SCHEME) or "light"
    doc.title, doc.template = title, template()
    doc.config.update(reconnect_session=False, notify_connection_status=False)  # the page's script sees to it
    doc.template_variables.update(variables(title, pieces, scheme, ("bokeh", *libraries)))


def words(name: str, text: str = "") -> Div:
    """Return a place for HTML of ours."""
    return Div(text=text, name=name, **WIDE)


WIDE: dict[str, Any] = {"sizing_mode": "stretch_width", "stylesheets": [SHEET]}
"""Of widgets as wide as there is room."""
MOST_ROWS = 6
"""Of a list that are seen at once."""
LINE = ":host{align-items:end;flex-wrap:wrap}"
"""Style of a row that goes on below itself where it is narrow."""


def button(label: str, act: Callable[[], object], **more: Any) -> Button:
    """Return a button, named as it is labelled, in small letters."""
    found = Button(label=label, **{"name": label.lower(), "stylesheets": [SHEET]} | more)
    found.on_click(act)
    return found


def several(title: str, options: Sequence[str], name: str) -> MultiSelect:
    """Return a list of which several entries may be chosen; it shows names as they are, never as HTML."""
    rows = max(2, min(MOST_ROWS, len(options)))
    return MultiSelect(title=f"{title} (Ctrl for several)", options=list(options), size=rows, name=name, **WIDE)
