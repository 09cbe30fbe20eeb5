"""What `fmuid diagnose` prints: the verdict, what each fault model found, and what is to be known of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape

from fmuid.reports.console.layout import console, table_of, unit_text
from fmuid.reports.words.diagnosis import (
    chance,
    change_name,
    change_size,
    hypothesis_notes,
    scope_notes,
    simulation_notes,
    strain_words,
    verdict,
)
from fmuid.text import rounded, with_std

if TYPE_CHECKING:
    from fmuid.diagnosis import Diagnosis, Evidence, Hypothesis, Size

COLORS = {"healthy": "green", "undecided": "yellow"}


def show_diagnosis(found: Diagnosis) -> None:
    """Print the verdict, the table of the faults looked for, and the notes."""
    out = console()
    out.print()
    out.print(f"[bold {COLORS.get(found.kind, 'red')}]{escape(verdict(found))}[/]", soft_wrap=True)
    out.print()
    rows = [_row(found, each, size, first=k == 0) for each in found.hypotheses for k, size in enumerate(each.sizes)]
    shown = [name for name in rows[0] if any(row[name] for row in rows)]
    table = table_of("Faults looked for", shown, right=("D", "threshold", "probability"))
    for row in rows:
        table.add_row(*(escape(row[name]) for name in shown))
    out.print(table)
    out.print()
    if found.evidence is not None:
        _show_evidence(found.evidence)
    nominal = ", ".join(f"{name} = {with_std(value, std)}" for name, (value, std) in _common(found).items())
    out.print(f"Common mode: {escape(nominal)}", soft_wrap=True)
    noisy = "larger than" if found.unexplained.larger else "as large as"
    out.print(
        f"Residual: {noisy} the noise of the healthy machine (variance {found.unexplained.ratio:.3g} times it, "
        f"probability {found.unexplained.probability:.2g})",
        soft_wrap=True,
    )
    for note in strain_words(found.strain):
        out.print(f"[yellow]note:[/] {escape(note)}", soft_wrap=True)
    for each in found.hypotheses:
        for note in hypothesis_notes(each):
            out.print(f"[yellow]note:[/] {escape(each.name)}: {escape(note)}", soft_wrap=True)
    for note in (*simulation_notes(found), *scope_notes(found)):
        out.print(f"[yellow]note:[/] {escape(note)}", soft_wrap=True)


def _show_evidence(evidence: Evidence) -> None:
    """Print every cause alone, the likeliest first."""
    named = {change_name(change) for each in evidence.explanations for change in each.changes}
    table = table_of("What may be new beside the healthy records", ("cause", "size", "D", "probability", "nearest", ""),
                     right=("D", "probability"))  # fmt: skip
    for each in sorted(evidence.suspects, key=lambda each: each.probability):
        name = change_name(each.change)
        near = f"{each.rival}, {math.degrees(each.rival_angle):.0f}°" if each.rival else ""
        table.add_row(
            escape(name), escape(change_size(each.change)), f"{each.statistic:.4g}", chance(each.probability),
            escape(near), "named" if name in named else "",
        )  # fmt: skip
    out = console()
    out.print(table)
    out.print(f"Error of the fault models along other signatures: {100 * evidence.model_error:.2g} % of their effect")
    out.print()


def _common(found: Diagnosis) -> dict[str, tuple[float, float]]:
    """Return the nominal parameters beside the fault that was named, or without any."""
    return dict(found[found.named[0]].common if found.named else found.nominal)


def _row(found: Diagnosis, each: Hypothesis, size: Size, *, first: bool) -> dict[str, str]:
    """Return the cells of a size by their heads; what concerns the fault as a whole stands in its first row."""
    low, high = size.interval()
    known, width = math.isfinite(size.std), 0.5 * size.std
    at = size.angle and each.located(size, found.level)
    return {
        "fault": each.name if first else "",
        "size": f"{size.name} = {with_std(size.value, size.std)}" if known else f"{size.name} not determined",
        "interval (95 %)": f"{rounded(low, width)} to {rounded(high, width)}" if known else "",
        "unit": unit_text(size.unit),
        "at": f"{size.angle} = {with_std(size.angle_value, size.angle_std)}" if at else "",
        "D": f"{each.statistic:.4g}" if first else "",
        "threshold": f"{each.threshold:.4g}" if first else "",
        "probability": chance(each.adjusted if first else size.probability),
        "": ("named" if each.name in found.named else "less likely" if each.name in found.called else "")
        if first
        else "",
    }
