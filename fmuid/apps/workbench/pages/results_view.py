"""View of a results folder that follows its files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from bokeh.layouts import column

from fmuid.apps.workbench.pages.live import in_scheme
from fmuid.apps.workbench.widgets import SHEET, line, words
from fmuid.errors import InputError
from fmuid.files import is_file
from fmuid.reports import documents_of
from fmuid.reports.document import Document
from fmuid.reports.render.document_json import DOCUMENT_FILE
from fmuid.reports.render.html import drawn_sections, section_head, verdict
from fmuid.reports.render.html import text as escaped

EVERY = 1000  # ms between two looks at the folder
FILES = {"identification": "result.json"}  # files of kinds with another name


class ResultsView:
    """Documents of some kinds in a results folder, kept up to date."""

    def __init__(self, doc: Any, place: Path, scheme: str, kinds: Sequence[str]) -> None:
        self.place, self.scheme, self.kinds = place, scheme, kinds
        self._seen: object = None
        self.layout = column([], name="shown", sizing_mode="stretch_width", stylesheets=[SHEET])
        self.look()
        doc.add_periodic_callback(self.look, EVERY)

    def look(self) -> None:
        """Show changes since the last look; incomplete files wait."""
        names = (DOCUMENT_FILE, *(FILES.get(kind, f"{kind}.json") for kind in self.kinds))
        seen = [(name, (self.place / name).stat().st_mtime_ns) for name in names if is_file(self.place / name)]
        if seen == self._seen:
            return
        try:
            found = documents_of(self.place) if seen else {}
        except InputError as error:
            if not self.layout.children:
                self.layout.children = [words("wrong", f"<p class=error>{escaped(error)}</p>")]
            return
        shown = [each for kind, each in found.items() if kind in self.kinds]
        nothing = [words("nothing", "<p>No result yet.</p>")]
        self.layout.children = models(shown, self.scheme) if shown else nothing
        self._seen = seen


def models(documents: Iterable[Document], scheme: str) -> list[Any]:
    """Return documents as Bokeh models: words and figures."""
    found = []
    for document in documents:
        found.append(words("verdict", verdict(document)))
        for each in drawn_sections(document):
            found.append(words(each.key, section_head(each)))
            found.append(side_by_side(in_scheme(each.charts, scheme)))
    return found


def side_by_side(figures: Sequence[Any]) -> Any:
    """Return figures side by side, if there is room."""
    for each in figures:
        each.sizing_mode, each.width_policy, each.min_width = "stretch_width", "max", 280
        each.styles = {"flex": "1 1 280px"}
    return line(*figures)
