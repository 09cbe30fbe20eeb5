"""What `fmuid diagnose` prints: the verdict, what each cause would be, and what is to be known of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.markup import escape

from fmuid.formatting import with_std
from fmuid.reports.console.layout import console, show_remarks, show_sentences, table_of
from fmuid.reports.messages.diagnosis import causes_columns, diagnosis_notes, verdict

if TYPE_CHECKING:
    from fmuid.diagnosis import Diagnosis

COLORS = {"healthy": "green", "undecided": "yellow"}


def show_diagnosis(found: Diagnosis) -> None:
    """Print the verdict, the table of the causes looked at, and the notes."""
    out = console()
    out.print()
    out.print(f"[bold {COLORS.get(found.kind, 'red')}]{escape(verdict(found))}[/]", soft_wrap=True)
    out.print()
    columns = causes_columns(found)
    del columns["interval (95 %)"]  # no room beside the others
    out.print(table_of("What may be new", columns, right=("D", "probability")))
    out.print(
        f"Error of the fault models along other signatures: {100 * found.evidence.model_error:.2g} % of their effect"
    )
    out.print()
    nominal = ", ".join(f"{name} = {with_std(value, std)}" for name, (value, std) in found.nominal.items())
    show_sentences([f"Common mode: {nominal}"])
    noisy = "larger than" if found.unexplained.larger else "as large as"
    ratio, probability = found.unexplained.ratio, found.unexplained.probability
    times = f"variance {ratio:.3g} times it, probability {probability:.2g}"
    show_sentences([f"Residual: {noisy} the noise of the healthy machine ({times})"])
    show_remarks(diagnosis_notes(found))
