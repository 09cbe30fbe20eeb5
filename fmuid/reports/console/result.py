"""What `fmuid identify` prints: estimates, prior and data side by side, residuals, intervals, and what they mean."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from fmuid.estimation import TerminationReason
from fmuid.formatting import rounded, two_digits, unit_text, with_std
from fmuid.identification import CONFIDENCE_LEVEL, LEAST_STD_FACTOR, RIVAL_CRITERION, SamplingWarning
from fmuid.models import SolverConfiguration
from fmuid.reports.console.layout import PLAIN_WIDTH, TERMINAL_ROWS, console, show_remarks, show_sentences, table_of
from fmuid.reports.messages.accuracy import passed_words, shift_text
from fmuid.reports.messages.prior_and_data import reading_words
from fmuid.reports.messages.residuals import residual_words
from fmuid.reports.messages.result import capitalised, effort_words, ending, finding_remarks, fit_words, result_words
from fmuid.reports.messages.solver import run_words, sensitivity_words
from fmuid.reports.messages.uncertainty import posterior_words, uncertainty_words

if TYPE_CHECKING:
    from fmuid.estimation import Result
    from fmuid.identification import Assessment, PriorDataComparison
    from fmuid.runs import IdentificationRun
    from fmuid.simulation import OutputFit

SHIFT = "numerical shift"
"""The column of what the error of the simulation moves each estimate by, in its standard deviations."""
# Lines that a result takes where it is printed, those of the table's head among them.
SUMMARY_LINES, HEAD_LINES = 25, 2
# To ask how wide a table would be.
UNLIMITED_WIDTH = 10_000


def show_findings(found: IdentificationRun) -> None:
    """Print what is new in findings: the result, or the uncertainty around it; or the point where a search was left."""
    if found.assessment.residuals is None:
        show_point(found.result)
    elif found.assessment.is_explored:
        show_uncertainty(found)
    else:
        show_result(found)


def show_result(found: IdentificationRun) -> None:
    """Print estimates and their uncertainty, what is to be said of them, noise, and how the search ended."""
    out, result, fits = console(), found.result, found.fits
    out.print()
    if result.optima:
        out.print(_optima(out, result))
        show_remarks(_rivals(result))
        out.print()
    out.print(_filled(_estimates(out, result, found.assessment.level)))
    reading, residuals, units = found.assessment.prior_and_data, found.assessment.residuals, found.output_units
    if found.has_prior and reading is not None:
        out.print()
        out.print(_reading(out, reading, found.unit_of))
    show_remarks(finding_remarks(found))
    show_sentences([] if reading is None else reading_words(reading, units))
    show_sentences([] if residuals is None else residual_words(residuals, units))
    show_sentences([f"Fit (NRMSE): {fit_words(fits)}", f"Residual: {_noise(result, fits)}"])
    color = "green" if result.converged else "red"
    out.print(f"[bold {color}]{escape(capitalised(ending(result)))}[/]", soft_wrap=True)
    for component, model in result.models.items():
        run = run_words(SolverConfiguration(**model["run"]))
        out.print(f"[dim]{escape(component or model['name'])} run as {escape(run)}[/]", soft_wrap=True)
    if result.accuracy is not None and (passed := passed_words(result.accuracy)):
        out.print(f"[dim]{escape(passed)}[/]", soft_wrap=True)
    if result.sensitivity is not None:
        out.print(f"[dim]sensitivities by {escape(sensitivity_words(result.sensitivity))}[/]", soft_wrap=True)
    out.print(f"[dim]{effort_words(result)}[/]")


def _optima(out: Console, result: Result) -> Table:
    """Return the table of the optima found, the best first; of many parameters the first ones that fit."""
    shown = result.optima[:TERMINAL_ROWS]
    values = {name: [f"{optimum.theta[i]:.5g}" for optimum in shown] for i, name in enumerate(result.names)}
    columns = {
        "criterion": [f"{optimum.criterion:.6g}" for optimum in shown],
        "found": [f"{optimum.hits} x" for optimum in shown],
        **values,
        "note": ["" if optimum.converged else "not converged" for optimum in shown],
    }
    if all(optimum.converged for optimum in shown):
        columns.pop("note")
    searches = sum(optimum.hits for optimum in result.optima)
    title = f"Optima found by {searches} search{'es' if searches > 1 else ''}"
    right = ("criterion", "found", *result.names)
    return _filled(_narrowed(out, columns, result.names[::-1]), right, title)


def _rivals(result: Result) -> list[str]:
    """Return a sentence on each optimum that fits as well as the best one."""
    best = result.optima[0]
    return [
        f"another optimum fits as well (criterion higher by {other.criterion - best.criterion:.2g}), "
        + ", ".join(f"{name} = {value:.5g}" for name, value in zip(result.names, other.theta.tolist(), strict=True))
        + ": the data do not tell which is true; narrow the bounds, give a prior or measure more"
        for other in result.optima[1:]
        if other.criterion - best.criterion < RIVAL_CRITERION
    ]


def summary(result: Result) -> str:
    """Return the table of estimates, of many the first ones, and the sentences on them, in `SUMMARY_LINES` at most."""
    out = Console(file=io.StringIO(), width=PLAIN_WIDTH, highlight=False)
    columns = _estimates(out, result, CONFIDENCE_LEVEL)
    said = [line for words in result_words(result) for line in wrap(capitalised(words, result.names), PLAIN_WIDTH)]
    room = SUMMARY_LINES - HEAD_LINES
    rows, hidden = len(result.names), 0
    if rows + 1 + len(said) > room:
        shown = max(room - 2 - len(said), room // 2)
        rows, hidden = min(rows, shown), max(0, rows - shown)
        left = room - rows - 1 - (hidden > 0)
        said = said if len(said) <= left else [*said[: left - 1], "… fmuid.describe(result) says the rest"]
    out.width = UNLIMITED_WIDTH  # so that no cell takes a second line
    out.print(_filled({head: cells[:rows] for head, cells in columns.items()}))
    assert isinstance(out.file, io.StringIO)
    lines = [line.rstrip() for line in out.file.getvalue().splitlines()]
    return "\n".join([*lines, *([f"… {hidden} more"] if hidden else []), "", *said])


def _estimates(out: Console, result: Result, level: float) -> dict[str, list[str]]:
    """Return the columns of the table of estimates; on a narrow console fewer."""
    return _narrowed(out, _columns(result, level), ("start", "rel. std", SHIFT, "note"))


def _reading(out: Console, reading: PriorDataComparison, units: Mapping[str, str | None]) -> Table:
    """Return prior, data and both side by side, how far the prior is, and what moved the data's optimum by how much."""
    rows = {
        "prior": (reading.prior_mean, reading.prior_std),
        "data alone": (reading.data, reading.data_std),
        "both": (reading.combined, reading.combined_std),
    }
    columns = {"parameter": list(reading.names)}
    for head, (values, stds) in rows.items():
        pairs = zip(values.tolist(), stds.tolist(), strict=True)
        columns[head] = [_known(value, std) for value, std in pairs]
    columns["pull"] = [f"{pull:+z.2f} std" if math.isfinite(pull) else "" for pull in reading.pull.tolist()]
    moves = zip(reading.moved.tolist(), reading.moved_by, strict=True)
    columns["moved by prior"] = [
        f"{moved:+z.2f} std ({by})" if math.isfinite(moved) and by else "" for moved, by in moves
    ]
    columns["unit"] = list(map(unit_text, units.values()))
    return _filled(_narrowed(out, columns, ("unit", "moved by prior")), title="Prior and data")


def _known(value: float, std: float) -> str:
    """Return value and standard deviation, nothing where there are none."""
    if not math.isfinite(value):
        return ""
    return with_std(value, std) if std < math.inf else "not determined"


def _narrowed(out: Console, columns: dict[str, list[str]], droppable: Iterable[str]) -> dict[str, list[str]]:
    """Return the columns without those that may be dropped, one after the other, until the console has room."""
    for name in droppable:
        if _fits(out, columns):
            break
        columns.pop(name, None)
    return columns


def _filled(
    columns: Mapping[str, Sequence[str]],
    right: Sequence[str] = ("rel. std", "numerical shift", "start", "pull"),
    title: str = "",
) -> Table:
    return table_of(title, columns, right)


def _fits(out: Console, columns: Mapping[str, Sequence[str]]) -> bool:
    unlimited = out.options.update(max_width=UNLIMITED_WIDTH)
    return Measurement.get(out, unlimited, _filled(columns)).maximum <= out.width


def _columns(result: Result, level: float) -> dict[str, list[str]]:
    """Return the cells of the table of estimates, column by column."""
    cells: dict[str, list[str]] = {"parameter": list(result.names)}
    rows = list(zip(result.values.tolist(), result.std.tolist(), strict=True))
    known = [math.isfinite(std) for _, std in rows]
    limits = result.intervals(level).to_numpy().tolist()
    # where nothing is known of a value, its digits must not look as if there were
    cells["value"] = [f"{value:.2g} ± ?" if std == math.inf else with_std(value, std) for value, std in rows]
    if result.outcome is not TerminationReason.STALLED:  # which has no intervals
        shares = [f"{100 * std / abs(value):.2g} %" if value and std < math.inf else "" for value, std in rows]
        cells["rel. std"] = shares
        cells[f"{100 * level:.4g} % interval"] = [
            f"{rounded(lower, std)} to {rounded(upper, std)}" if sure else "not determined"
            for (lower, upper), (_, std), sure in zip(limits, rows, known, strict=True)
        ]
    if result.accuracy is not None:
        cells[SHIFT] = list(map(shift_text, result.numerical_shift.tolist()))
    cells["unit"] = [unit_text(result.units.get(name)) for name in result.names]
    cells["start"] = [f"{start:.6g}" for start in result.start]
    notes = [_note(result, name, factor) for name, factor in zip(result.names, result.widening, strict=True)]
    return cells | ({"note": notes} if any(notes) else {})


def _note(result: Result, name: str, factor: float) -> str:
    """Return what the table's last column says of one parameter."""
    words = []
    if any(bound.name == name for bound in result.at_bounds):
        words.append("at its bound")
    if factor >= LEAST_STD_FACTOR:
        words.append(f"std {two_digits(factor)} x white noise's")
    return ", ".join(words)


def show_uncertainty(found: IdentificationRun) -> None:
    """Print the intervals side by side, local, profile and posterior, and what is to be known of them."""
    there = found.assessment
    out = console()
    if there.profiles or there.posterior is not None:
        out.print()
        out.print(_intervals(out, found, there))
    show_remarks(uncertainty_words(there))
    if there.posterior is not None and there.posterior.converged:
        show_sentences([f"Posterior: {posterior_words(there.posterior)}"])
    if there.interrupted:
        out.print("[bold red]Interrupted: this is what there is[/]")


def _intervals(out: Console, found: IdentificationRun, there: Assessment) -> Table:
    limits, posterior = there.intervals(found.result), there.posterior
    kinds = list(dict.fromkeys(limits.columns.get_level_values(0)))
    columns: dict[str, list[str]] = {"parameter": list(found.result.names)}
    values = found.result.values.tolist()
    for kind in kinds:
        ends = limits[kind].to_numpy().tolist()
        columns[kind] = [_interval(lower, upper, value) for (lower, upper), value in zip(ends, values, strict=True)]
    if posterior is not None and posterior.doubt is not SamplingWarning.RUNAWAY:
        pairs = zip(posterior.mean.tolist(), posterior.std.tolist(), strict=True)
        columns["posterior mean"] = [with_std(mean, std) for mean, std in pairs]
    columns["unit"] = list(map(unit_text, found.unit_of.values()))
    columns = _narrowed(out, columns, ("unit", "posterior mean"))
    return _filled(columns, title=f"Intervals at {100 * found.assessment.level:.4g} %")


def _interval(lower: float, upper: float, value: float) -> str:
    """Return an interval in words: open where an end is infinite, empty where there is none."""
    if math.isnan(lower) or math.isnan(upper):
        return ""
    if math.isinf(lower) and math.isinf(upper):
        return "not determined"
    # about the standard deviation to which an interval of 95 % belongs
    if math.isinf(upper):
        return f"above {rounded(lower, 0.5 * (value - lower))}"
    if math.isinf(lower):
        return f"below {rounded(upper, 0.5 * (upper - value))}"
    width = 0.25 * (upper - lower)
    return f"{rounded(lower, width)} to {rounded(upper, width)}"


def _noise(result: Result, fits: Sequence[OutputFit]) -> str:
    """Return the standard deviation of each output's residual."""
    units = {output: unit for fit in fits for output, unit in zip(fit.outputs, fit.units, strict=True)}
    words = []
    for output, variance in result.noise_variance.items():
        given = result.given_variance.get(output)
        of = f" (given: {math.sqrt(given):.4g})" if given is not None else ""
        words.append(f"{output} std {math.sqrt(variance):.4g} {unit_text(units[output])}".rstrip() + of)
    return ", ".join(words)


def show_point(result: Result) -> None:
    """Say where a search was interrupted, where nothing but the values is known."""
    values = ", ".join(f"{name} = {result[name]:.6g}" for name in result.names)
    show_sentences([values, capitalised(ending(result))])
