"""Notes on a study, and the change that gains most."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence

import numpy as np

from fmuid.formatting import listed, two_digits
from fmuid.identification import TimeScaleMismatch, TimeScaleWarning, doubt_of_time
from fmuid.reports.document import Message, Remark, doubt
from fmuid.runs import ChangeKind, StudyChange
from fmuid.simulation import AnySimulator, Simulator
from fmuid.studies import SourceIssue, SourceWarning, Study
from fmuid.units import SECONDS

MOST_GAPS = 3  # gaps that are listed


class StudyMessage(Message):
    """Notes on a study, its data files and earlier results."""

    GAP = doubt(
        "{data}: rows missing after {times} s; inputs are interpolated.",
        remedy="Cut the data there if the inputs changed.",
    )
    TOO_LONG = doubt(
        "{data}: time unit looks wrong ({duration} s long, model settles in {constant} s).",
        "probably milliseconds or microseconds taken for seconds, or a wrong model",
        'Set `time_unit`, probably "{unit}"; "s" if the model counts in the unit of the file.',
    )
    TOO_SHORT = doubt(
        "{data}: time unit looks wrong ({duration} s long, model needs {constant} s).",
        "probably seconds taken for milliseconds, or a wrong model",
        'Set `time_unit`, for example "s".',
    )
    SIZE = doubt(
        "{data}: simulated {column} varies {ratio} times as much as measured.",
        "a wrong unit, or start values of another machine",
        'Set the units of {column} and of the inputs, for example U = "mV".',
    )
    MISSING = doubt("{data}: {count} of {rows} samples of {column!r} are missing.")
    NO_DATA = doubt("{data}: no column for {inputs}; start value used.")
    NOT_SUCCEEDED = doubt("{path}: this earlier result did not succeed ({outcome}).", remedy="Identify it again.")
    DOUBTFUL = doubt(
        "{path}: the verdict of this earlier result is DOUBTFUL ({reasons}).", remedy="Check it before you use it."
    )
    NO_MODEL = doubt("{path}: this earlier result names no model.", remedy="Identify it again.")
    OTHER_BUILD = doubt(
        "{path}: this earlier result used another build of {model} than {fmu}.",
        remedy="Identify it again if the equations changed.",
    )


def source_notes(study: Study) -> list[Remark]:
    """Return the warnings about results used as priors."""
    return [source_remark(each) for each in study.notes]


def input_notes(simulators: Iterable[AnySimulator]) -> list[Remark]:
    """Return inputs without data, and empty cells of rows."""
    found = []
    for each in simulators:
        own = each.experiment
        if names := ", ".join(each.unfed_inputs):
            found.append(StudyMessage.NO_DATA.said(data=own.source, inputs=names))
        for name, values in zip(own.output_names, own.output_values.T, strict=True) if own.kind != "time" else ():
            if count := int(np.isnan(values).sum()):
                found.append(missing_remark(own.source, own.columns[name], count, len(values)))
    return found


def missing_remark(source: str, column: str, count: int, rows: int) -> Remark:
    """Return the number of empty cells of a column."""
    return StudyMessage.MISSING.said(data=source, column=column, count=count, rows=rows)


def time_notes(study: Study, simulators: Sequence[AnySimulator]) -> list[Remark]:
    """Return the data files whose duration does not fit the model."""
    starts = [parameter.start for parameter in study.parameters.values()]
    in_time = [each for each in simulators if isinstance(each, Simulator)]
    found = (doubt_of_time(each, starts) for each in in_time[:5])  # each costs a simulation
    return [time_remark(each) for each in found if each is not None]


def gap_remark(source: str, times: Sequence[float]) -> Remark:
    """Return the gaps of a data file, by the times before, s."""
    some = ", ".join(f"{time:.6g}" for time in times[:MOST_GAPS]) + (", …" if len(times) > MOST_GAPS else "")
    return StudyMessage.GAP.said("fit", data=source, times=some)


def time_remark(found: TimeScaleWarning) -> Remark:
    """Return the reason to check the time unit of a data file."""
    message = StudyMessage.TOO_LONG if found.kind is TimeScaleMismatch.TOO_LONG else StudyMessage.TOO_SHORT
    fine = (unit for unit in ("ms", "us") if found.step * SECONDS[unit] < found.time_constant)
    values = {"duration": f"{found.duration:.3g}", "constant": f"{found.time_constant:.2g}", "unit": next(fine, "ns")}
    return message.said(data=found.source, **values)


def size_remark(source: str, column: str, ratio: float) -> Remark:
    """Return the reason to check the units of a column."""
    return StudyMessage.SIZE.said(data=source, column=repr(column), ratio=two_digits(ratio))


def source_remark(note: SourceWarning) -> Remark:
    """Return the warning about an earlier result."""
    path = str(note.path)
    match note.doubt:
        case SourceIssue.DID_NOT_SUCCEED:
            return StudyMessage.NOT_SUCCEEDED.said(path=path, outcome=note.outcome.value)
        case SourceIssue.DOUBTFUL:
            reasons = listed([each.value.replace("_", " ") for each in note.reasons])
            return StudyMessage.DOUBTFUL.said(path=path, reasons=reasons)
        case SourceIssue.NO_MODEL:
            return StudyMessage.NO_MODEL.said(path=path)
        case SourceIssue.OTHER_BUILD:
            assert note.fmu is not None
            return StudyMessage.OTHER_BUILD.said(path=path, model=note.fmu.name, fmu=note.fmu.path)


class ChangeMessage(Message):
    """Offered changes of a study, by `ChangeKind`; the score is the expected fall of −2 ln L."""

    FREE = "Free {subject}"
    INTERPOLATION = 'Interpolate {subject} by "{value}"'
    WARMUP = "Set a warm-up of {value} s in {subject}"
    OFFSET = "Subtract {value} from {subject}"


def change_title(found: StudyChange) -> str:
    """Return what a change does."""
    return ChangeMessage[ChangeKind(found.kind).name].text.format(subject=listed(found.subject), value=found.value)


def change_line(found: StudyChange) -> str:
    """Return a change with its score and the arguments of a command."""
    words = " ".join(f"--set {shlex.quote(each)}" for each in found.settings)
    return f"{change_title(found)} (−2 ln L falls by {found.gain:.3g}): `{words}`"
