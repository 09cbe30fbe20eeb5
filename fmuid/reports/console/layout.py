"""What the command line prints: tables, progress, sentences."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from fmuid.formatting import fit_text, label, visible, with_unit

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.simulation import OutputFit, Simulator
    from fmuid.studies import Study

# Into a file or a pipe, where nobody can widen the window: what a README shows without scrolling.
PLAIN_WIDTH = 110
# Records whose time is compared with the model's time constants: each costs a simulation.
MOST_TIMED = 5
# Rows of a table on a terminal; more scroll away what was first. A pipe gets them all.
TERMINAL_ROWS = 60


class _Console(Console):
    """A console that prints nothing that a terminal obeys or a reader cannot see, but for its own styles."""

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(visible(text), **options)


def console() -> Console:
    """Return the console on standard output as it is now."""
    return _Console(highlight=False, width=None if sys.stdout.isatty() else PLAIN_WIDTH)


def show_files(paths: Iterable[Path]) -> None:
    """Say where files went: one line a folder."""
    folders: dict[Path, list[str]] = {}
    for path in paths:
        folders.setdefault(path.parent, []).append(path.name)
    for folder, names in folders.items():
        console().print(f"Written to [bold]{escape(str(folder))}/[/]: {escape(', '.join(names))}", soft_wrap=True)


def show_remarks(sentences: Iterable[str]) -> None:
    """Print sentences that are no result and no error, one a line."""
    show_sentences(sentences, "[yellow]note:[/] ")


def show_sentences(sentences: Iterable[str], mark: str = "") -> None:
    """Print sentences, one a line, each after a mark."""
    for sentence in sentences:
        console().print(f"{mark}{escape(sentence)}", soft_wrap=True)


def table_of(title: str, columns: Mapping[str, Sequence[str | Text]], right: Sequence[str] = ()) -> Table:
    """Return a table in the style of all of them: a rule below the heads, no frame, no column without any cell."""
    from rich import box

    table = Table(
        title=title or None,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        header_style="dim",
        min_width=len(title) or None,  # a title takes no second line
    )
    table.pad_edge = table.show_edge = False
    shown = {head: cells for head, cells in columns.items() if any(cells)}
    for head in shown:
        table.add_column(escape(head), justify="right" if head in right else "left", overflow="fold")
    for cells in zip(*shown.values(), strict=True):
        table.add_row(*(escape(cell) if isinstance(cell, str) else cell for cell in cells))
    return table


def table_of_rows(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[str] = ()) -> Table:
    """Return rows of cells as such a table."""
    given = list(rows)
    return table_of(title, {head: [row[k] for row in given] for k, head in enumerate(heads)}, right)


# --- fmuid simulate ---------------------------------------------------------------------


def show_fits(fits: Sequence[OutputFit]) -> None:
    """Print the fit and the RMSE of each output of each experiment."""
    several = len(fits) > 1
    rows = []
    for fit in fits:
        for k, (output, percent, rmse) in enumerate(zip(fit.outputs, fit.fit, fit.rmse, strict=True)):
            counted = int(fit.counted[:, k].sum())
            said = (fit_text(percent), with_unit(rmse, fit.units[k])) if counted else ("not measured", "")
            rows.append((fit.experiment if several else "", label(output, fit.units[k]), *said, str(counted)))
    heads = ("experiment", "output", "fit", "RMSE", "samples")
    console().print(table_of_rows("Measured against simulated", heads, rows, right=heads[2:]))


def warn_unfed(simulators: Iterable[Simulator]) -> None:
    """Say which inputs keep their start values because nothing feeds them."""
    for simulator in simulators:
        if simulator.unfed_inputs:
            names = ", ".join(simulator.unfed_inputs)
            show_notes([f"{simulator.experiment.source} feeds no {names}: kept at the start value"])


def warn_of_time(study: Study, simulators: Sequence[Simulator]) -> None:
    """Say which records last much longer or shorter than what the model does."""
    from fmuid.identification import doubt_of_time
    from fmuid.reports.messages.result import time_words

    starts = [parameter.start for parameter in study.parameters.values()]
    doubts = (doubt_of_time(each, starts) for each in simulators[:MOST_TIMED])
    show_notes([time_words(doubt) for doubt in doubts if doubt is not None])


def note_sources(study: Study) -> None:
    """Print what is to be known of the results that a study takes priors from."""
    from fmuid.reports.messages.result import source_words

    show_notes(map(source_words, study.notes))


def show_frame(title: str, frame: pd.DataFrame) -> None:
    """Print a table of numbers with four digits each."""
    columns = {
        str(name): [f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in frame[name]] for name in frame
    }
    right = [str(name) for name in frame if frame[name].dtype.kind in "fi"]
    console().print(table_of(title, columns, right))


def show_notes(notes: Iterable[str]) -> None:
    """Print what is to be known of the input, to standard error."""
    for note in notes:
        print(visible(f"note: {note}"), file=sys.stderr)
