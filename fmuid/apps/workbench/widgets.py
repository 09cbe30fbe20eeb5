"""Widgets that pages share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from bokeh.layouts import row
from bokeh.models import Button, Div, MultiSelect, Select, TextInput

from fmuid.apps.workbench.page_layout import own_file

SHEET = own_file("widgets.css")  # style of widgets; the page's style gives only variables


def words(name: str, text: str = "") -> Div:
    """Return a place for HTML."""
    return Div(text=text, name=name, **WIDE)


WIDE: dict[str, Any] = {"sizing_mode": "stretch_width", "stylesheets": [SHEET]}  # of wide widgets
LINE = ":host{align-items:end;flex-wrap:wrap}"  # style of a row that wraps


def line(*children: Any, **more: Any) -> Any:
    """Return a row that wraps where it is narrow."""
    return row(*children, stylesheets=[LINE], sizing_mode="stretch_width", **more)


def on_change(act: Callable[[], object], *widgets: Any, name: str = "value") -> None:
    """Call `act` after each change of a property of widgets."""
    for each in widgets:
        each.on_change(name, lambda _attr, _old, _new: act())


def typed(title: str, value: str, name: str, width: int = 150) -> TextInput:
    """Return a text field."""
    return TextInput(title=title, value=value, name=name, width=width, stylesheets=[SHEET])


def choice(title: str, options: Sequence[str], name: str, value: str = "", **more: Any) -> Select:
    """Return a list for one choice."""
    return Select(title=title, options=list(options), value=value, name=name, stylesheets=[SHEET], **more)


def button(label: str, act: Callable[[], object], **more: Any) -> Button:
    """Return a button, named by its label in lower case."""
    found = Button(label=label, **{"name": label.lower(), "stylesheets": [SHEET]} | more)
    found.on_click(act)
    return found


def several(title: str, options: Sequence[str], name: str) -> MultiSelect:
    """Return a list for multiple choice; names are never HTML."""
    rows = max(2, min(6, len(options)))
    return MultiSelect(title=f"{title} (Ctrl for several)", options=list(options), size=rows, name=name, **WIDE)
