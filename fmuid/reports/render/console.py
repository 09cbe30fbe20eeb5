"""Documents on a terminal: tables, sentences, and how it ended."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

from fmuid.formatting import visible
from fmuid.reports.document import Column, Document, Remark, Section, Table

# Into a file or a pipe, where nobody can widen the window: what a README shows without scrolling.
PLAIN_WIDTH = 110
# Rows of a table on a terminal; more scroll away what was first. A pipe gets them all.
TERMINAL_ROWS = 60
# To ask how wide a table would be.
UNLIMITED_WIDTH = 10_000
TONES = {"good": "green", "doubt": "yellow", "bad": "red", "plain": ""}


class _Console(Console):
    """A console that prints nothing that a terminal obeys or a reader cannot see, but for its own styles."""

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(visible(text), **options)


def console() -> Console:
    """Return the console on standard output as it is now."""
    return _Console(highlight=False, width=None if sys.stdout.isatty() else PLAIN_WIDTH)


def show(document: Document, before: Document | None = None) -> None:
    """Print the tables of a document, its sentences and how it ended; not again what was shown `before`."""
    out = console()
    keys = set() if before is None else {each.key for each in before.sections}
    said = set() if before is None else {each.text for each in before.remarks}
    for section in (each for each in document.sections if each.key not in keys):
        show_section(section, out)
    out.print()
    show_remarks(each for each in document.remarks if each.text not in said)
    color = TONES[document.tone]
    out.print(f"[bold {color}]{escape(document.heading)}: {escape(document.state)}[/]", soft_wrap=True)


def show_section(section: Section, out: Console | None = None) -> None:
    """Print the table of a section and the sentences on it."""
    out = out or console()
    if section.table and "console" in section.shown:
        out.print()
        out.print(rich_table(section.table, section.heading, out))
        show_remarks(section.remarks)


def show_remarks(remarks: Iterable[Remark]) -> None:
    """Print sentences, one a line; doubts after a mark."""
    for each in remarks:
        mark = "[yellow]note:[/] " if each.tone in ("doubt", "bad") else ""
        console().print(f"{mark}{escape(each.text)}", soft_wrap=True)


def rich_table(columns: Table, title: str, out: Console, styles: Mapping[str, str] | None = None) -> RichTable:
    """Return a table with a rule below the heads, no frame, no column without any cell, and what there is room for.

    Cells of `styles` are painted so.
    """
    shown = [each for each in columns if any(each.cells)]
    hidden = 0
    if out.is_terminal and shown and len(shown[0].cells) > TERMINAL_ROWS:
        hidden = len(shown[0].cells) - TERMINAL_ROWS
    unlimited = out.options.update(max_width=UNLIMITED_WIDTH)
    for rank in sorted({each.rank for each in shown if each.rank}, reverse=True):
        if Measurement.get(out, unlimited, _table(shown, title, hidden, {})).maximum <= out.width:
            break
        shown = [each for each in shown if each.rank != rank]
    return _table(shown, title, hidden, styles or {})


def _table(columns: Iterable[Column], title: str, hidden: int, styles: Mapping[str, str]) -> RichTable:
    from rich import box

    made = RichTable(
        title=escape(title) or None,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        header_style="dim",
        min_width=len(title) or None,  # a title takes no second line
        caption=f"and {hidden} more" if hidden else None,
        caption_justify="left",
    )
    made.pad_edge = made.show_edge = False
    shown = list(columns)
    for each in shown:
        made.add_column(escape(each.head), justify="right" if each.number else "left", overflow="fold")
    rows = list(zip(*(each.cells for each in shown), strict=True))
    for cells in rows[: len(rows) - hidden]:
        made.add_row(*(Text(cell, style=styles[cell]) if cell in styles else escape(cell) for cell in cells))
    return made


def plain_table(columns: Table, rows: int | None = None) -> list[str]:
    """Return the lines of a table as text, of its first rows; no cell takes a second line."""
    out = Console(file=io.StringIO(), width=PLAIN_WIDTH, highlight=False)
    made = rich_table(columns, "", out)
    assert isinstance(out.file, io.StringIO)
    out.width = UNLIMITED_WIDTH
    out.print(made)
    lines = [line.rstrip() for line in out.file.getvalue().splitlines()]
    return lines if rows is None else lines[: rows + 2]


def show_files(paths: Iterable[Path]) -> None:
    """Say where files went: one line a folder."""
    folders: dict[Path, list[str]] = {}
    for path in paths:
        folders.setdefault(path.parent, []).append(path.name)
    for folder, names in folders.items():
        console().print(f"Written to [bold]{escape(str(folder))}/[/]: {escape(', '.join(names))}", soft_wrap=True)


def show_notes(notes: Iterable[str]) -> None:
    """Print what is to be known of the input, to standard error."""
    for note in notes:
        print(visible(f"note: {note}"), file=sys.stderr)
