"""Assumptions, model errors that were found, and those that could hide."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from fmuid.estimation import Doubt
from fmuid.formatting import listed, two_digits, unit_text, with_std
from fmuid.identification import DataDefect, DefectKind, DirectedTest, Direction, ErrorKind, ModelError, ModelErrors
from fmuid.reports.chart import Axis, Chart, Data, Layer, kinds, rows_of
from fmuid.reports.document import DETAIL, PAGE, Message, Remark, Section, doubt, plain, table_of_rows

SHOWN_EXPOSURES, SHOWN_ALTERNATIVES = 12, 3  # errors in table and figure: those that move an estimate most
VERBOSE = DETAIL | PAGE
HIDING_CAPTION = (
    "Shift of the most affected estimate by an error of usual size, and by the largest error that would not show. "
    "An error shows if the directed tests name it in 95 % of records."
)


class ModelErrorMessage(Message, section="hiding"):
    """Model errors that the directed tests name, by `ErrorKind`."""

    DELAY = doubt("{first} late by {size}", "sensor filters, or channels sampled one after the other", "Set the delay.")
    ADVANCE = doubt(
        "{first} early by {size}",
        "a clock that runs ahead, held inputs, or a fast path such as eddy currents",
        "Check `interpolation`; shift the time of {first}, or model the path.",
    )
    LAG = doubt("{first} lags by {size}", "a sensor's filter, or a part that stores energy", "Model the filter.")
    CLOCK = doubt(
        "{first} late by {size} at the end", "clocks of different rates, or lost samples", "Record with one clock."
    )
    INPUT_DELAY = doubt("{first} late by {size}", remedy="Shift the time of {first}.")
    INPUT_ADVANCE = doubt("{first} early by {size}", remedy="Shift the time of {first}.")
    RESPONSE_DELAY = doubt("{first} late by {size}", "channels not read at one instant", "Set `delay` of {first}.")
    INTERPOLATION = doubt("interpolation of {first} is wrong", remedy="Change `interpolation`.")
    OFFSET = doubt("offset of {first} is {size}", remedy="Remove it with `preprocess`, or free it.")
    ZERO_DRIFT = doubt("offset of {first} grows by {size}", remedy="Remove it with `preprocess`.")
    INPUT_OFFSET = doubt("offset of {first} is {size}", remedy="Remove it with `preprocess`.")
    GAIN = doubt("gain of {first} is off by {size}", remedy="Calibrate {first}.")
    NONLINEARITY = doubt(
        "gain of {first} falls by {size} at its largest value", "a sensor near its range", "Calibrate {first}."
    )
    HYSTERESIS = doubt("{first} lacks {size} against its slope", "play, or remanence of a sensor", "Check the sensor.")
    INPUT_GAIN = doubt("gain of {first} is off by {size}", "a sensor's calibration", "Calibrate {first}.")
    JOINT = doubt("the line of {first} has {size} more", "a joint or contact", "Check it, or set `phase_resistance`.")
    DEAD_TIME = doubt(
        "dead time of {inputs}: {size} against the sign of {outputs}",
        "an inverter's dead time, or friction",
        "Model the dead time, or measure the voltage at the machine.",
    )
    SATURATION = doubt(
        "{first} depends on amplitude ({size} at the largest {others})",
        "saturation: the estimate belongs to the amplitude of the record",
        "Let {first} depend on the amplitude, or record at one amplitude.",
    )
    STATE_DEPENDENCE = doubt(
        "{first} depends on {others} ({size} at the largest)",
        "saturation: the estimate belongs to the amplitude of the record",
        "Let {first} depend on {others}, or record at one amplitude.",
    )
    DRIFT = doubt("{first} drifts by {size}", "temperature, or wear", "Shorten the record, or model the drift.")
    STEP = doubt("{first} changes by {size} at half time", remedy="Split the record.")
    INITIAL_STATE = doubt("initial {first} is off by {size}", "the record starts in motion", "Set a longer `warmup`.")
    FIXED = doubt("fixed {first} is off by {size}", remedy="Free {first}.")
    PRIOR = doubt(
        "prior of {first} is off by {size}", "or what stands beside it", "Check the prior of {first}, and the sensors."
    )


class DefectMessage(Message, section="residuals"):
    """Defects of recorded outputs, by `DefectKind`."""

    QUANTIZED = doubt("{output} has steps of {ratio:.2g} × noise level", "a coarse converter: σ does not hold")
    CLIPPED = doubt("{output} is clipped at {limit:.4g}", "the sensor's range ended: estimates are biased")
    EXCLUDED = plain(
        "stretches of {output} clipped at {limit:.4g} do not count",
        "samples where the model is within 3 σ of the sensor's end",
    )
    REPEATED = doubt("{output} repeats {share:.0%} of its samples", "a channel slower than its clock")
    HUM = plain("{output} has a hum of {frequency:.4g} Hz", "mains, or a resonance: σ allows for it")
    OUTLYING = doubt(
        "row {row:.0f} of {experiment} is off by {size:.3g} σ in {output} ({rows:.0f} such rows)",
        "a typing error, or another steady state than the measured one",
        "Check these rows, or start nearer to the estimates.",
    )
    TWICE = doubt(
        "{share:.0%} of the rows of {experiment} stand twice", "copied rows make σ too small", "Remove the copies."
    )
    SEVERAL = doubt(
        "row {row:.0f} of {experiment} has several steady states at the estimates",
        "the model settles at one or the other",
        "Set `guess` near the right one.",
    )
    EVENT = doubt(
        "row {row:.0f} of {experiment} is at an event at the estimates", "a kink: σ does not hold", "Remove the row."
    )
    CONJUGATE = doubt(
        "imaginary part of {output} has the wrong sign (fit {fit:.0f}% with the other)",
        "some instruments save −Im or −phase",
        "Change `conjugate` of this response.",
    )
    SIGN = doubt(
        "{output} has the wrong sign (fit {fit:.0f}% with the other)",
        "a current or voltage that counts against its arrow",
        'Write `computed_columns = { i = "-i" }`, or `of = "-u / i"` for a response.',
    )
    RADIANS = doubt(
        "phases of {output} are in radians (fit {fit:.0f}%)",
        "they are read as degrees",
        'Set `units = { "Z.phase" = "rad" }` for response Z.',
    )
    LINE_VOLTAGE = doubt(
        "voltage of {experiment} is between lines (fit {fit:.0f}%)",
        "it is read as that of a phase",
        "Set `line_voltage` in place of `voltage` in `frame`.",
    )
    PHASE_VOLTAGE = doubt(
        "voltage of {experiment} is that of a phase (fit {fit:.0f}%)",
        "it is read as that between lines",
        "Set `voltage` in place of `line_voltage` in `frame`.",
    )
    UNEVEN = plain("noise of {output} is uneven ({factor:.2g} ×)", "it follows the signal or time: σ allows for it")
    EITHER = plain(
        "few rows of {output}: noise may be constant or follow the reading",
        "σ allows for both; set `noise.std` or `noise.reading_std` if it is known",
    )


class HidingMessage(Message, section="hiding"):
    """Model errors that were tested, and those that the data cannot show."""

    SHIFT = doubt("{error}: {name} moves by {shift} σ (p = {probability}).")
    FREED = plain("Freed in this result: {error}.", "the size is a parameter of the fit; intervals include it")
    PROCESS_NOISE = plain(
        "Noise looks like a disturbance of {states} ({share} of its variance).",
        "a load or voltage that is no input; σ allows for its color",
    )
    NONE = plain(
        "No model error found in {count} directions (level {level}).",
    )
    HIDDEN = plain(
        "Could hide: {error} of {usual} moves {name} by {shift} σ; shows from {detectable}.",
        "the largest shift by an error of usual size that would not show",
    )
    UNTESTABLE = plain(
        "Not testable: {errors}.", "the parameters make up for these errors; the largest shift comes first"
    )


def size_text(direction: Direction, size: float, std: float = math.nan) -> str:
    """Return a size with σ and unit."""
    scale, unit = (100.0, "%") if direction.kind.is_relative else (1.0, unit_text(direction.unit))
    shown = with_std(scale * size, scale * std) if math.isfinite(std) else two_digits(scale * size)
    return f"{shown} {unit}".strip()


def error_names(direction: Direction) -> str:
    """Return a short name of an error: ``gain of ids``."""
    subject, kind = direction.subject, direction.kind
    if kind is ErrorKind.DEAD_TIME:
        subject = subject[: len(subject) // 2]
    elif kind in (ErrorKind.SATURATION, ErrorKind.STATE_DEPENDENCE):
        subject = subject[:1]
    by = f" by {direction.subject[1]}" if kind is ErrorKind.SATURATION and len(direction.subject) > 1 else ""
    what = "value" if kind is ErrorKind.FIXED else kind.value.replace("_", " ")
    return f"{what} of {listed(subject)}{by}"


def _fields(kind: ErrorKind, subject: Sequence[str], size: str) -> dict[str, str]:
    half = len(subject) // 2
    whole = kind.is_output_delay or kind is ErrorKind.INTERPOLATION
    return {
        "first": listed(subject if whole else subject[:1]),
        "others": listed(subject[1:]),
        "inputs": listed(subject[:half]),
        "outputs": listed(subject[half:]),
        "size": size,
    }


def defect_words(found: Doubt) -> str:
    """Return a defect of a recorded output."""
    kind, output, experiment = found.subject
    text = DefectMessage[DefectKind(kind).name].text
    return text.format(output=output, experiment=experiment, **found.values).replace("%", " %")


def defect_remedy(found: Doubt) -> str:
    """Return what to do about a defect; empty for what all have in common."""
    return DefectMessage[DefectKind(found.subject[0]).name].remedy


def defect_remarks(found: Sequence[DataDefect]) -> list[Remark]:
    """Return the defects for which σ allows."""
    told = [(DefectMessage[each.kind.name], each) for each in found if not each.kind.is_doubt]
    return [message.said(output=each.output, **each.values) for message, each in told]


def error_words(found: Doubt) -> str:
    """Return a model error of a verdict."""
    return _sized(_direction(found), found.values["size"], found.values["std"], _alternatives(found))


def error_remedy(found: Doubt) -> str:
    """Return the remedies of a model error and its alternatives."""
    shown = [_direction(found), *_alternatives(found)[:SHOWN_ALTERNATIVES]]
    told = (ModelErrorMessage[each.kind.name].remedy.format(**_fields(each.kind, each.subject, "")) for each in shown)
    return " ".join(dict.fromkeys(filter(None, told)))


def _alternatives(found: Doubt) -> list[Direction]:
    return [Direction(ErrorKind(kind), tuple(subject), "", math.nan) for kind, *subject in found.alternatives]


def _direction(found: Doubt) -> Direction:
    kind, _, unit, *subject = found.subject
    return Direction(ErrorKind(kind), tuple(subject), unit, math.nan)


def _error_text(error: ModelError) -> str:
    return _sized(error.test.direction, error.test.size, error.test.std, error.alternatives)


def _sized(direction: Direction, size: float, std: float, others: Sequence[Direction]) -> str:
    """Return an error with its size, and those that explain as much."""
    fields = _fields(direction.kind, direction.subject, size_text(direction, size, std))
    names = [error_names(each) for each in others]
    more = [f"{len(names) - SHOWN_ALTERNATIVES} more"] if len(names) > SHOWN_ALTERNATIVES else []
    text = ModelErrorMessage[direction.kind.name].text.format(**fields)
    return ", or ".join([text, *names[:SHOWN_ALTERNATIVES], *more])


def model_error_remarks(found: ModelErrors | None) -> list[Remark]:
    """Return the model errors found, or what could hide."""
    if found is None:
        return []
    said = [HidingMessage.FREED.said(error=_error_text(each)) for each in found.freed]
    for each in found.errors:
        i, shift = each.test.most
        values = {"error": _error_text(each), "name": found.names[i], "shift": f"{shift * abs(each.test.size):.2g}"}
        said.append(HidingMessage.SHIFT.said(**values, probability=f"{each.test.probability:.1g}"))
    if (noise := found.process_noise) is not None:
        values = {"states": " or ".join(noise.states), "share": f"{100 * noise.share:.0f} %"}
        said.append(HidingMessage.PROCESS_NOISE.said(**values))
    if not found.errors:
        tested = sum(each.is_testable for each in found.tests)
        said.append(HidingMessage.NONE.said(count=tested, level=f"{100 * found.level:g} %"))
    return [*said, *hidden_remarks(found)]


def hidden_remarks(found: ModelErrors) -> list[Remark]:
    """Return errors that cannot be seen, and the gravest that could hide."""
    named = {each.test.direction.key for each in (*found.errors, *found.freed)}
    large = takewhile(lambda each: not each.most[1] * each.direction.usual < 0.1, found.exposures)
    open_ = [each for each in large if each.detectable > each.direction.usual and each.direction.key not in named]
    moves = {}
    for each in open_:
        (i, shift), direction = each.most, each.direction
        usual, moved = size_text(direction, direction.usual), two_digits(shift * direction.usual)
        moves[each] = {"error": error_names(direction), "usual": usual, "name": found.names[i], "shift": moved}
    never = [moves[each] for each in open_ if not each.is_testable]
    texts = ["{error} ({usual} moves {name} by {shift} σ)".format(**each) for each in never]
    more = [f"{len(texts) - SHOWN_ALTERNATIVES} more"] if len(texts) > SHOWN_ALTERNATIVES else []
    said = [HidingMessage.UNTESTABLE.said(errors=", ".join(texts[:SHOWN_ALTERNATIVES] + more))] if texts else []
    hidden = next((each for each in open_ if each.is_testable), None)
    if hidden is not None:
        detectable = size_text(hidden.direction, hidden.detectable)
        said.append(HidingMessage.HIDDEN.said(**moves[hidden], detectable=detectable))
    return said if not open_ or not open_[0].is_testable else said[::-1]


def hiding_section(found: ModelErrors | None) -> list[Section]:
    """Return what could hide: table and figure."""
    if found is None:
        return []
    tests = [each for each in found.exposures if each.most[1] * each.direction.usual > 0.01][:SHOWN_EXPOSURES]
    if not tests:
        return []
    rows = []
    for each in tests:
        i, shift = each.most
        shows = size_text(each.direction, each.detectable) if each.is_testable else "not testable"
        until = f"{two_digits(each.hidden)} σ" if each.is_testable else "without limit"
        usual = f"{found.names[i]} by {two_digits(shift * each.direction.usual)} σ"
        rows.append((error_names(each.direction), size_text(each.direction, each.direction.usual), usual, shows, until))
    table = table_of_rows(
        ("error", "usual size", "moves", "shows from", "moves until then"), rows, ("usual size", "moves", "shows from")
    )
    return [
        Section("hiding", "What could hide", HIDING_CAPTION, table=table, charts=(_hiding_chart(tests),), shown=VERBOSE)
    ]


def _hiding_chart(tests: Sequence[DirectedTest]) -> Chart:
    names = tuple(error_names(each.direction) for each in tests)
    usual = np.array([each.most[1] * each.direction.usual for each in tests])
    until = np.array([each.hidden for each in tests])
    testable, hover = np.isfinite(until), (("shift", "@x{0.00} σ"),)
    shown: Data = {"x": usual, "y": names}
    ends: Data = {"x": until, "y": names}
    layers = [
        Layer("points", shown, size=9, label="usual size", hover=hover),
        *kinds("points", ends, [("shows beyond", "amber", testable)], size=10, marker="bar", hover=hover),
        *kinds("points", shown, [("not testable", "red", ~testable)], size=9, marker="x"),
        Layer("rule", {"x": np.array([1.0])}, "grey", dash="dashed"),
    ]
    return rows_of(names, Axis("shift of the most affected estimate, σ", "log"), layers, 110)


def assumed_section(found: ModelErrors | None, rows: Sequence[tuple[str, str, str]]) -> list[Section]:
    """Return what was assumed: fixed parameters with their effect, and `rows` of what, value and effect."""
    fixed = [] if found is None else [each for each in found.exposures if each.direction.kind is ErrorKind.FIXED]
    cells = [
        (
            f"{each.direction.subject[0]} fixed",
            f"{each.direction.value:.6g}",
            f"{size_text(each.direction, each.direction.usual)} moves {found.names[each.most[0]]} by "
            f"{two_digits(each.most[1] * each.direction.usual)} σ",
        )
        for each in fixed
        if found is not None
    ]
    cells += list(rows)
    table = table_of_rows(("assumption", "value", "effect"), cells, ("value", "effect"))
    return [Section("assumed", "What was assumed", table=table, shown=VERBOSE)] if cells else []
