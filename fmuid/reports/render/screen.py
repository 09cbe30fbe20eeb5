"""Amount of a command's output on a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fmuid.reports.document import Document


@dataclass
class Screen:
    """Output options of a command, and its last document."""

    verbose: bool = False
    quiet: bool = False
    json: bool = False
    document: Document | None = None

    @property
    def silent(self) -> bool:
        """True if no text is printed."""
        return self.quiet or self.json

    @property
    def doubtful(self) -> bool:
        """True if the document has a doubt."""
        found = self.document
        tones = [] if found is None else [found.tone, *(each.tone for each in found.remarks)]
        return "doubt" in tones or "bad" in tones


_current = Screen()


def screen() -> Screen:
    """Return the screen of the command that runs."""
    return _current


@contextmanager
def showing(chosen: Screen) -> Iterator[Screen]:
    """Use a screen for a command; at its end, print the document as JSON if asked for."""
    global _current  # one command runs at a time
    before, _current = _current, chosen
    try:
        yield chosen
        if chosen.json and chosen.document is not None:
            from fmuid.reports.render.document_json import table_json

            print(table_json(chosen.document), end="")
    finally:
        _current = before
