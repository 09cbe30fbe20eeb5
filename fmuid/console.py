"""What the command line prints: tables, progress, sentences."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from fmuid.report import has_unit, label, rounded, with_std

if TYPE_CHECKING:
    from fmuid.fmi.archive import FMU
    from fmuid.fmi.description import Description, Interface, Variable
    from fmuid.report import Fit
    from fmuid.result import Result
    from fmuid.simulator import Simulator
    from fmuid.study_init import Draft

# Into a file or a pipe, where nobody can widen the window: what a README shows without scrolling.
PLAIN_WIDTH = 110
# Rows of a table on a terminal; more scroll away what was first. A pipe gets them all.
TERMINAL_ROWS = 60
# To ask how wide a table would be.
UNLIMITED = 10_000


def console() -> Console:
    """Return the console on standard output as it is now."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else PLAIN_WIDTH)


def show_files(paths: Iterable[Path]) -> None:
    """Say where files went: one line a folder."""
    folders: dict[Path, list[str]] = {}
    for path in paths:
        folders.setdefault(path.parent, []).append(path.name)
    for folder, names in folders.items():
        console().print(f"Written to [bold]{escape(str(folder))}/[/]: {escape(', '.join(names))}", soft_wrap=True)


# --- fmuid info -------------------------------------------------------------------------


def show_fmu(fmu: FMU) -> None:
    """Print what an FMU declares."""
    described, out = fmu.description, console()
    remark = described.description.removeprefix(described.model_name).lstrip(": ")
    out.print(f"[bold]{escape(described.model_name)}[/]" + (f": {escape(remark)}" if remark else ""))
    facts = Table.grid(padding=(0, 2))
    facts.add_row("FMI version", described.fmi_version)
    for interface in described.interfaces.values():
        facts.add_row(interface.kind, _capabilities(interface))
    facts.add_row("platforms", ", ".join(fmu.platforms) or "none (no binaries)")
    if described.default_experiment:
        facts.add_row("default experiment", _default_experiment(described))
    if described.generation_tool:
        facts.add_row("made by", escape(described.generation_tool))
    out.print(facts)
    variables = list(described.variables.values())
    shown = {
        "Parameters": [v for v in variables if v.causality == "parameter"],
        "Inputs": described.with_causality("input"),
        "Outputs": described.with_causality("output"),
        "States": [v for v in variables if v.is_state],
    }
    for title, some in shown.items():
        _show_variables(out, title, some)
    names = {variable.name for some in shown.values() for variable in some}
    rest = len(variables) - len(names)
    if rest:
        out.print(f"\n{rest} other variables")


def _capabilities(interface: Interface) -> str:
    """Return the capabilities of one interface in words."""
    words = [
        *(["variable communication steps" if interface.variable_step else "communication steps of one length"]
          if interface.kind == "co-simulation" else []),
        *(["interpolates inputs"] if interface.interpolates_inputs else []),
        *(["gets and sets its state"] if interface.get_set_state else []),
        *(["serialises its state"] if interface.serialize_state else []),
        *(["directional derivatives"] if interface.directional_derivatives else []),
        *(["once per process"] if interface.once_per_process else []),
        *(["needs its tool"] if interface.needs_execution_tool else []),
    ]  # fmt: skip
    return ", ".join(words) or "no optional capabilities"


def _default_experiment(described: Description) -> str:
    words = {"start": "start {:g} s", "stop": "stop {:g} s", "step_size": "step {:g} s", "tolerance": "tolerance {:g}"}
    given = described.default_experiment
    return ", ".join(text.format(given[word]) for word, text in words.items() if word in given)


def _show_variables(out: Console, title: str, variables: Sequence[Variable]) -> None:
    if not variables:
        return
    rows = variables if not out.is_terminal else variables[:TERMINAL_ROWS]
    bounded = any(v.min is not None or v.max is not None for v in rows)
    heads = ["name", "start", "unit", *(["min", "max"] if bounded else []), "description"]
    table = _table(f"{title} ({len(variables)})", heads, right=("start", "min", "max"))
    for v in rows:
        bounds = [_plain(v.min), _plain(v.max)] if bounded else []
        # A free text that FMUs fill as they like: one line of it.
        remark = " ".join(v.description.split()) + ("" if v.variability != "constant" else " (constant)")
        table.add_row(*(escape(text) for text in (v.name, _plain(v.start), _unit(v.unit), *bounds, remark.strip())))
    out.print()
    out.print(table)
    if len(rows) < len(variables):
        out.print(f"and {len(variables) - len(rows)} more; all of them: fmuid info FMU | less")


def _plain(value: float | int | bool | str | None) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _unit(unit: str | None) -> str:
    return unit if unit is not None and has_unit(unit) else ""


def _table(title: str, heads: Iterable[str], right: Sequence[str] = ()) -> Table:
    """Return an empty table in the style of all of them: a rule below the heads, no frame."""
    from rich import box

    table = Table(
        title=title or None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, header_style="dim"
    )
    table.pad_edge = table.show_edge = False
    for head in heads:
        table.add_column(head, justify="right" if head in right else "left", overflow="fold")
    return table


# --- fmuid init -------------------------------------------------------------------------


def show_draft(draft: Draft, output: Path) -> None:
    """Say what was matched and what comes next."""
    out = console()
    for word, matched, missing in (
        ("inputs", draft.inputs, draft.missing_inputs),
        ("outputs", draft.outputs, draft.missing_outputs),
    ):
        out.print(f"{word}: {escape(', '.join(matched)) or 'none'}", soft_wrap=True)
        if missing:
            out.print(f"  no column of the table: {escape(', '.join(missing))}", soft_wrap=True)
    if draft.unused:
        out.print(f"columns that are no input or output: {escape(', '.join(draft.unused))}", soft_wrap=True)
    out.print(
        f"Written: [bold]{escape(str(output))}[/]. Next: free the parameters to identify in it, under \\[parameters].",
        soft_wrap=True,
    )


# --- fmuid simulate ---------------------------------------------------------------------


def show_misfits(fits: Sequence[Fit]) -> None:
    """Print the relative misfit of each output of each experiment."""
    several = len(fits) > 1
    heads = [*(["experiment"] if several else []), "output", "misfit", "samples"]
    table = _table("Measured against simulated", heads, right=("misfit", "samples"))
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
            print(f"note: {simulator.experiment.source} feeds no {names}: kept at the start value", file=sys.stderr)


# --- fmuid identify ----------------------------------------------------------------------


def show_result(result: Result, units: Sequence[str | None], fits: Sequence[Fit]) -> None:
    """Print estimates and their uncertainty, what is to be said of them, noise, and how the search ended."""
    out = console()
    out.print()
    for table in _estimates(out, result, units):
        out.print(table)
    for sentence in _remarks(result):
        out.print(f"[yellow]note:[/] {escape(sentence)}", soft_wrap=True)
    out.print(f"Misfit: {escape(_misfit(fits))}", soft_wrap=True)
    out.print(f"Residual: {escape(_noise(result, fits))}", soft_wrap=True)
    color = "green" if result.converged else "red"
    out.print(f"[bold {color}]{escape(result.status[0].upper() + result.status[1:])}[/]", soft_wrap=True)
    out.print(
        f"[dim]{result.iterations} iterations, {result.simulations} simulations, {result.elapsed_s:.2f} s; "
        f"criterion {result.criterion:.6g}[/]"
    )


def _estimates(out: Console, result: Result, units: Sequence[str | None]) -> list[Table]:
    """Return the table of estimates; on a narrow console with fewer columns, the priors in a table of their own."""
    columns = _columns(result, units)
    for dropped in ("note", "rel. std", "start"):
        if _fits(out, columns):
            break
        columns.pop(dropped, None)
    if _fits(out, columns) or "prior" not in columns:
        return [_filled(columns)]
    apart = {head: columns.pop(head) for head in ("prior", "pull")}
    return [_filled(columns), _filled({"parameter": columns["parameter"]} | apart)]


def _filled(columns: Mapping[str, Sequence[str]]) -> Table:
    table = _table("", columns, right=("rel. std", "start", "pull"))
    for cells in zip(*columns.values(), strict=True):
        table.add_row(*(escape(cell) for cell in cells))
    return table


def _fits(out: Console, columns: Mapping[str, Sequence[str]]) -> bool:
    unlimited = out.options.update(max_width=UNLIMITED)
    return Measurement.get(out, unlimited, _filled(columns)).maximum <= out.width


def _columns(result: Result, units: Sequence[str | None]) -> dict[str, list[str]]:
    """Return the cells of the table of estimates, column by column."""
    found: dict[str, list[str]] = {"parameter": list(result.names)}
    rows = list(zip(result.values.tolist(), result.std.tolist(), strict=True))
    known = [math.isfinite(std) for _, std in rows]
    limits = result.intervals().to_numpy().tolist()
    found["value"] = [with_std(value, std) + ("" if std < math.inf else " ± ?") for value, std in rows]
    found["rel. std"] = [f"{100 * std / abs(value):.2g} %" if value and std < math.inf else "" for value, std in rows]
    found["95 % interval"] = [
        f"{rounded(lower, std)} to {rounded(upper, std)}" if sure else "not determined"
        for (lower, upper), (_, std), sure in zip(limits, rows, known, strict=True)
    ]
    found["unit"] = [_unit(unit) for unit in units]
    found["start"] = [f"{start:.6g}" for start in result.start]
    if np.isfinite(result.prior_mean).any():
        priors = list(zip(result.prior_mean.tolist(), result.prior_std.tolist(), result.pull.tolist(), strict=True))
        found["prior"] = [with_std(mean, std) if math.isfinite(mean) else "" for mean, std, _ in priors]
        found["pull"] = [f"{pull:+.2f} std" if math.isfinite(pull) else "" for *_, pull in priors]
    notes = [_note(result, name) for name in result.names]
    return found | ({"note": notes} if any(notes) else {})


def _note(result: Result, name: str) -> str:
    """Return what the table's last column says of one parameter."""
    held = any(sentence.startswith(f"{name} is at its bound") for sentence in result.at_bounds)
    return "at its bound" if held else ""


def _remarks(result: Result) -> list[str]:
    """Return the sentences on what the estimates do not show by themselves."""
    pairs = [
        f"{one} and {other} move together (correlation {share:+.3f}): their intervals do not hold one by one"
        for one, other, share in result.strong_correlations
    ]
    prior = [f"without the prior, {sentence}" for sentence in result.prior_determined]
    return [*pairs, *result.weak, *prior]


def _misfit(fits: Sequence[Fit]) -> str:
    """Return the relative misfit of each output of each experiment."""
    words = []
    for fit in fits:
        shares = [f"{output} {100 * misfit:.3g} %" for output, misfit in zip(fit.outputs, fit.misfit, strict=True)]
        words.append((f"{fit.experiment}: " if len(fits) > 1 else "") + ", ".join(shares))
    return "; ".join(words)


def _noise(result: Result, fits: Sequence[Fit]) -> str:
    """Return the standard deviation of each output's residual."""
    units = {output: unit for fit in fits for output, unit in zip(fit.outputs, fit.units, strict=True)}
    words = []
    for output, variance in result.noise_variance.items():
        given = result.given_variance.get(output)
        of = f" (given: {math.sqrt(given):.4g})" if given is not None else ""
        words.append(f"{output} std {math.sqrt(variance):.4g} {_unit(units[output])}".rstrip() + of)
    return ", ".join(words)
