"""Documents on a terminal, and how much of them."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

from fmuid.formatting import visible
from fmuid.reports.document import TERMINAL_ROWS, Column, Document, Remark, Section, Table, capitalized
from fmuid.reports.publish import REPORT_FILE

PLAIN_WIDTH = 110  # width without a terminal and COLUMNS, as a README shows it without scrolling
PIPE_WIDTH = 1000  # width of a listing in a pipe: one line a variable
UNLIMITED_WIDTH = 10_000  # width to measure a table
LABEL_WIDTH = 13  # columns of the labels before the lines of a summary
RESULTS = {"ok": "green", "warning": "yellow", "failed": "bold red"}  # style of results of checks
TONES = {"good": "green", "doubt": "yellow", "bad": "red", "plain": ""}


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


class _Console(Console):
    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(visible(text), **options)


def console() -> Console:
    """Return the console on standard output as it is now; COLUMNS gives its width."""
    fixed = not sys.stdout.isatty() and not os.environ.get("COLUMNS")
    return _Console(highlight=False, width=PLAIN_WIDTH if fixed else None, quiet=screen().silent)


def show(document: Document, before: Document | None = None) -> None:
    """Print a document without the parts that were shown `before`."""
    screen().document = document
    if document.reason:
        _show_summary(document, before)
        return
    out = console()
    known, told = _known(before)
    for section in (each for each in document.sections if each.key not in known):
        show_section(section, out)
    out.print()
    show_remarks((each for each in document.remarks if each.text not in told), out)
    color = TONES[document.tone]
    out.print(f"[bold {color}]{escape(document.heading)}: {escape(document.state)}[/]", soft_wrap=True)


def _known(before: Document | None) -> tuple[set[str], set[str]]:
    if before is None:
        return set(), set()
    return {each.key for each in before.sections}, {each.text for each in before.remarks}


def _show_summary(document: Document, before: Document | None) -> None:
    """Print state and reason, tables, labeled lines and the most severe remedy; with ``--verbose`` all remarks."""
    out = console()
    known, told = _known(before)
    if before is None or (document.state, document.reason) != (before.state, before.reason):
        color, state = TONES[document.tone], capitalized(document.state)
        out.print(f"[bold {color}]{state:<{LABEL_WIDTH}}[/]{escape(document.reason)}", soft_wrap=True)
    for section in (each for each in document.sections if each.key not in known):
        show_section(section, out)
    lines = [each for each in document.summary if before is None or each not in before.summary]
    if lines:
        out.print()
    for label, text in lines:
        out.print(f"{label:<{LABEL_WIDTH}}{escape(text)}", soft_wrap=True)
    new = [each for each in document.remarks if each.text not in told]
    if screen().verbose or not document.summary:
        out.print()
        show_remarks(new, out)
        return
    remedies = [each.remedy for tone in ("bad", "doubt") for each in new if each.tone == tone and each.remedy]
    remedy = document.remedy or "".join(remedies[:1])
    if remedy and (before is None or remedy != before.remedy):
        out.print(f"→ {escape(remedy)}", soft_wrap=True)


def show_listing(document: Document, what: str) -> None:
    """Print a document with whole tables, and its study file."""
    screen().document = document
    out = console()
    if not out.is_terminal and not os.environ.get("COLUMNS"):
        out.width = PIPE_WIDTH
    out.print(f"[bold]{escape(document.heading)}[/]" + (f": {escape(document.state)}" if document.state else ""))
    for each in document.sections:
        if each.heading:
            out.print(f"\n[bold]{escape(each.heading)}[/]")  # a title of the table itself would wrap
        if not each.heading or out.is_terminal:
            out.print(rich_table(each.table, "", out))
        elif not out.quiet:
            out.file.writelines(plain_lines(each.table))
        show_remarks(each.remarks, out)
    for remark in document.remarks:
        out.print(f"\n{escape(remark.text)}")
    out.print(f"\n{what}\n")
    for line in document.study.splitlines():
        out.print(line, markup=False, soft_wrap=True)


def plain_lines(columns: Table) -> Iterator[str]:
    """Yield the lines of a table; Rich takes a minute for 100,000 rows."""
    filled = [_filled([each.head, *each.cells], flush_right=each.number) for each in columns]
    for number, row in enumerate(zip(*filled, strict=True)):
        line = "   ".join(row)
        yield line.rstrip() + "\n"
        if number == 0:
            yield "─" * cell_len(line) + "\n"


def _filled(texts: Sequence[str], *, flush_right: bool) -> list[str]:
    """Return texts padded to one width in terminal columns."""
    plain = "".join(texts).isascii()
    widths = [(len if plain or text.isascii() else cell_len)(text) for text in texts]
    widest = max(widths)
    if plain:
        return [text.rjust(widest) if flush_right else text.ljust(widest) for text in texts]
    blanks = [" " * (widest - width) for width in widths]
    return [blank + text if flush_right else text + blank for text, blank in zip(texts, blanks, strict=True)]


def show_section(section: Section, out: Console | None = None) -> None:
    """Print the table of a section and the sentences on it."""
    out = out or console()
    if section.table and ("detail" if screen().verbose else "console") in section.shown:
        out.print()
        out.print(rich_table(section.table, section.heading, out))
        show_remarks(section.remarks, out)


def show_remarks(remarks: Iterable[Remark], out: Console | None = None) -> None:
    """Print sentences, one a line; doubts after a mark, remedies below."""
    out = out or console()
    for each in remarks:
        mark = "[yellow]note:[/] " if each.tone in ("doubt", "bad") else ""
        out.print(f"{mark}{escape(each.text)}", soft_wrap=True)
        if each.remedy:
            out.print(f"→ {escape(each.remedy)}", soft_wrap=True)


def rich_table(columns: Table, title: str, out: Console) -> RichTable:
    """Return a table with the columns that fit."""
    shown = [each for each in columns if any(each.cells)]
    hidden = 0
    if out.is_terminal and shown and len(shown[0].cells) > TERMINAL_ROWS:
        hidden = len(shown[0].cells) - TERMINAL_ROWS
    unlimited = out.options.update(max_width=UNLIMITED_WIDTH)
    for rank in sorted({each.rank for each in shown if each.rank}, reverse=True):
        if Measurement.get(out, unlimited, _table(shown, title, hidden)).maximum <= out.width:
            break
        shown = [each for each in shown if each.rank != rank]
    return _table(shown, title, hidden)


def _table(shown: Sequence[Column], title: str, hidden: int) -> RichTable:
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
        show_header=any(each.head.strip() for each in shown),
    )
    made.pad_edge = made.show_edge = False
    for each in shown:
        made.add_column(escape(each.head), justify="right" if each.number else "left", overflow="fold")
    rows = list(zip(*(each.cells for each in shown), strict=True))
    for cells in rows[: len(rows) - hidden]:
        pairs = zip(shown, cells, strict=True)
        made.add_row(*(Text(cell, RESULTS.get(cell, "")) if c.head == "result" else escape(cell) for c, cell in pairs))
    return made


def plain_table(columns: Table, rows: int | None = None) -> list[str]:
    """Return the lines of a table as text."""
    out = Console(file=io.StringIO(), width=PLAIN_WIDTH, highlight=False)
    made = rich_table(columns, "", out)
    assert isinstance(out.file, io.StringIO)
    out.width = UNLIMITED_WIDTH
    out.print(made)
    lines = [line.rstrip() for line in out.file.getvalue().splitlines()]
    return lines if rows is None else lines[: rows + 2]


def show_files(paths: Iterable[Path]) -> None:
    """Print the path of the report; with ``--verbose`` or without report, all files."""
    files, out = list(paths), console()
    report = next((path for path in files if path.name == REPORT_FILE), None)
    if report is not None and not screen().verbose:
        out.print(f"{'Report':<{LABEL_WIDTH}}[bold]{escape(str(report))}[/]", soft_wrap=True)
        return
    folders: dict[Path, list[str]] = {}
    for path in files:
        folders.setdefault(path.parent, []).append(path.name)
    for folder, names in folders.items():
        out.print(f"Written to [bold]{escape(str(folder))}/[/]: {escape(', '.join(names))}", soft_wrap=True)


def show_notes(notes: Iterable[Remark | str]) -> None:
    """Print notes to standard error, remedies below."""
    for note in () if screen().quiet else notes:
        print(visible(f"note: {note}"), file=sys.stderr)
