"""What the command line prints: tables, progress, sentences."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from fmuid.text import has_unit, label, visible

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.simulation import Fit, Simulator
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
    for sentence in sentences:
        console().print(f"[yellow]note:[/] {escape(sentence)}", soft_wrap=True)


def unit_text(unit: str | None) -> str:
    """Return the unit as a cell of a table: nothing where there is none."""
    return unit if unit is not None and has_unit(unit) else ""


def table_of(title: str, heads: Iterable[str], right: Sequence[str] = ()) -> Table:
    """Return an empty table in the style of all of them: a rule below the heads, no frame."""
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
    for head in heads:
        table.add_column(head, justify="right" if head in right else "left", overflow="fold")
    return table


# --- fmuid simulate ---------------------------------------------------------------------


def show_misfits(fits: Sequence[Fit]) -> None:
    """Print the relative misfit of each output of each experiment."""
    several = len(fits) > 1
    heads = [*(["experiment"] if several else []), "output", "misfit", "samples"]
    table = table_of("Measured against simulated", heads, right=("misfit", "samples"))
    for fit in fits:
        for k, (output, misfit) in enumerate(zip(fit.outputs, fit.misfit, strict=True)):
            counted = int(fit.counted[:, k].sum())
            cells = [label(output, fit.units[k]), f"{100 * misfit:.3g} %" if counted else "not measured", str(counted)]
            table.add_row(*(escape(cell) for cell in ([fit.experiment, *cells] if several else cells)))
    console().print(table)


def warn_unfed(simulators: Iterable[Simulator]) -> None:
    """Say which inputs keep their start values because nothing feeds them."""
    for simulator in simulators:
        if simulator.unfed_inputs:
            names = ", ".join(simulator.unfed_inputs)
            show_notes([f"{simulator.experiment.source} feeds no {names}: kept at the start value"])


def warn_of_time(study: Study, simulators: Sequence[Simulator]) -> None:
    """Say which records last much longer or shorter than what the model does."""
    from fmuid.model_problem import doubt_of_time
    from fmuid.reports.words.result import time_words

    starts = [parameter.start for parameter in study.parameters.values()]
    doubts = (doubt_of_time(each, starts) for each in simulators[:MOST_TIMED])
    show_notes([time_words(doubt) for doubt in doubts if doubt is not None])


def note_sources(study: Study) -> None:
    """Print what is to be known of the results that a study takes priors from."""
    from fmuid.reports.words.result import source_words

    show_notes(map(source_words, study.notes))


def show_frame(title: str, frame: pd.DataFrame) -> None:
    """Print a table of numbers with four digits each."""
    table = table_of(title, frame.columns, right=[name for name in frame.columns if frame[name].dtype.kind in "fi"])
    for row in frame.itertuples(index=False):
        table.add_row(*(escape(f"{cell:.4g}" if isinstance(cell, float) else str(cell)) for cell in row))
    console().print(table)


def show_notes(notes: Iterable[str]) -> None:
    """Print what is to be known of the input, to standard error."""
    for note in notes:
        print(visible(f"note: {note}"), file=sys.stderr)
