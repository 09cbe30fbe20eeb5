"""What `fmuid diagnose` prints: the verdict, what each fault model found, and what is to be known of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape

from fmuid.formatting import with_std
from fmuid.reports.console.layout import console, show_remarks, show_sentences, table_of, table_of_rows
from fmuid.reports.messages.diagnosis import (
    chance,
    change_name,
    change_size,
    faults_columns,
    hypothesis_notes,
    scope_notes,
    simulation_notes,
    strain_words,
    verdict,
)

if TYPE_CHECKING:
    from fmuid.diagnosis import ChangeEvidence, Diagnosis

COLORS = {"healthy": "green", "undecided": "yellow"}


def show_diagnosis(found: Diagnosis) -> None:
    """Print the verdict, the table of the faults looked for, and the notes."""
    out = console()
    out.print()
    out.print(f"[bold {COLORS.get(found.kind, 'red')}]{escape(verdict(found))}[/]", soft_wrap=True)
    out.print()
    out.print(table_of("Faults looked for", faults_columns(found), right=("D", "threshold", "probability")))
    out.print()
    if found.evidence is not None:
        _show_evidence(found.evidence)
    nominal = ", ".join(f"{name} = {with_std(value, std)}" for name, (value, std) in _common(found).items())
    show_sentences([f"Common mode: {nominal}"])
    noisy = "larger than" if found.unexplained.larger else "as large as"
    ratio, probability = found.unexplained.ratio, found.unexplained.probability
    times = f"variance {ratio:.3g} times it, probability {probability:.2g}"
    show_sentences([f"Residual: {noisy} the noise of the healthy machine ({times})"])
    show_remarks(strain_words(found.strain))
    show_remarks(f"{each.name}: {note}" for each in found.hypotheses for note in hypothesis_notes(each))
    show_remarks([*simulation_notes(found), *scope_notes(found)])


def _show_evidence(evidence: ChangeEvidence) -> None:
    """Print every cause alone, the likeliest first."""
    named = {change_name(change) for each in evidence.explanations for change in each.changes}
    rows = []
    for each in sorted(evidence.suspects, key=lambda each: each.probability):
        name = change_name(each.change)
        near = f"{each.rival}, {math.degrees(each.rival_angle):.0f}°" if each.rival else ""
        size, d, share = change_size(each.change), f"{each.statistic:.4g}", chance(each.probability)
        rows.append((name, size, d, share, near, "named" if name in named else ""))
    heads, out = ("cause", "size", "D", "probability", "nearest", ""), console()
    out.print(table_of_rows("What may be new beside the healthy records", heads, rows, right=("D", "probability")))
    out.print(f"Error of the fault models along other signatures: {100 * evidence.model_error:.2g} % of their effect\n")


def _common(found: Diagnosis) -> dict[str, tuple[float, float]]:
    """Return the nominal parameters beside the fault that was named, or without any."""
    return dict(found[found.named[0]].common if found.named else found.nominal)
