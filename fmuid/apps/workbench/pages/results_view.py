"""What a folder of results says, on a page that follows it: shown anew when a command has written there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bokeh.layouts import column, row

from fmuid.apps.workbench.home import escaped
from fmuid.apps.workbench.page_layout import LINE, SHEET, words
from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.reports.interactive.live import in_scheme
from fmuid.reports.page.document import Part, text, written_parts
from fmuid.reports.page.write import FILES, contents

EVERY = 1000
"""Milliseconds between two looks at the folder."""
LEAST_WIDTH = 280
"""Of a figure beside others."""


class ResultsView:
    """The report of a folder, as long as somebody looks at it.

    Parameters
    ----------
    doc : Document
    place : Path
    scheme : "light" or "dark"
    kinds : sequence of str
        The files of `FILES` that it shows.

    Attributes
    ----------
    layout : Bokeh model
    """

    def __init__(self, doc: Any, place: Path, scheme: str, kinds: Sequence[str] = FILES) -> None:
        self.place, self.scheme, self.kinds = place, scheme, kinds
        self._seen: object = None
        self.layout = column([], name="shown", sizing_mode="stretch_width", stylesheets=[SHEET])
        self.look()
        doc.add_periodic_callback(self.look, EVERY)

    def look(self) -> None:
        """Show what has been written since the last look; files that do not go together yet are looked at again."""
        there = [name for name in self.kinds if is_file(self.place / name)]
        seen = [(name, (self.place / name).stat().st_mtime_ns) for name in there]
        if seen == self._seen:
            return
        if not there:
            self.layout.children = [words("nothing", "<p>There is no result yet.</p>")]
            self._seen = seen
            return
        try:
            _, parts = contents(self.place, there)
        except InputError as error:
            if not self.layout.children:
                self.layout.children = [words("wrong", f"<p class=error>{escaped(error)}</p>")]
            return
        self.layout.children = models(parts, self.scheme)
        self._seen = seen


def models(parts: Iterable[Part], scheme: str) -> list[Any]:
    """Return what parts of a report say, below each other: words and figures."""
    found = []
    for part in parts:
        found.append(words("verdict", written_parts([replace(part, sections=())])[0]))
        for each in part.sections:
            caption = f"<p class=caption>{text(each.caption)}</p>" if each.caption else ""
            found.append(words(each.name, f"<h3>{text(each.heading)}</h3>{caption}{each.body}"))
            found.append(side_by_side([in_scheme(figure, scheme) for figure in each.figures]))
    return found


def side_by_side(figures: Sequence[Any]) -> Any:
    """Return figures beside each other, where there is room."""
    for each in figures:
        each.sizing_mode, each.width_policy, each.min_width = "stretch_width", "max", LEAST_WIDTH
        each.styles = {"flex": f"1 1 {LEAST_WIDTH}px"}
    return row(*figures, sizing_mode="stretch_width", stylesheets=[LINE])
