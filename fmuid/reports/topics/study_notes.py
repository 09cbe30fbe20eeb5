"""Notes on a study and its data files: earlier results, gaps, units, inputs without data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from fmuid.formatting import listed, two_digits
from fmuid.identification import TimeScaleMismatch, TimeScaleWarning
from fmuid.simulation import Simulator
from fmuid.studies import SourceIssue, SourceWarning, Study

MOST_TIMED = 5
"""Records whose time is compared with the model's time constants: each costs a simulation."""


def source_notes(study: Study) -> list[str]:
    """Return the warnings about results used as priors."""
    return [source_words(each) for each in study.notes]


def input_notes(simulators: Iterable[Simulator]) -> list[str]:
    """Return the inputs without data."""
    return [
        f"{each.experiment.source} feeds no {', '.join(each.unfed_inputs)}: kept at the start value"
        for each in simulators
        if each.unfed_inputs
    ]


def time_notes(study: Study, simulators: Sequence[Simulator]) -> list[str]:
    """Return the data files whose duration does not fit the model."""
    from fmuid.identification import doubt_of_time

    starts = [parameter.start for parameter in study.parameters.values()]
    doubts = (doubt_of_time(each, starts) for each in simulators[:MOST_TIMED])
    return [time_words(doubt) for doubt in doubts if doubt is not None]


SHOWN_DROPOUTS = 3


def dropout_words(source: str, times: Sequence[float]) -> str:
    """Return the gaps of a data file, by the times before, s."""
    some = ", ".join(f"{time:.6g}" for time in times[:SHOWN_DROPOUTS]) + (", …" if len(times) > SHOWN_DROPOUTS else "")
    return f"{source}: rows are missing after t = {some} s; inputs go on there as between any samples"


def time_words(doubt: TimeScaleWarning) -> str:
    """Return the reason to check the time unit of a data file."""
    lasts = f"{doubt.source} lasts {doubt.duration:.3g} s in steps of {doubt.step:.3g} s"
    look = 'look at the unit of its time, and say it by time_unit = "ms" or what it is'
    match doubt.kind:
        case TimeScaleMismatch.TOO_LONG:
            return f"{lasts}, and what the model does is over in {doubt.time_constant:.2g} s (ms?): {look}"
        case TimeScaleMismatch.TOO_SHORT:
            return f"{lasts}, and the model takes {doubt.time_constant:.2g} s for what it does (s, not ms?): {look}"


def size_words(source: str, column: str, ratio: float) -> str:
    """Return the reason to check the units of a column."""
    return (
        f"{source}: at the FMU's own values what {column!r} measures moves {two_digits(ratio)} times as far as "
        'measured: look at the units of its column and of the inputs\', and say them by units, as in U = "mV"'
    )


def source_words(note: SourceWarning) -> str:
    """Return the warning about an earlier result."""
    match note.doubt:
        case SourceIssue.DID_NOT_SUCCEED:
            return f"{note.path}, an earlier result, did not succeed: {note.outcome.value}"
        case SourceIssue.DOUBTFUL:
            why = listed([each.value.replace("_", " ") for each in note.reasons])
            return f"{note.path}: the verdict on this earlier result is DOUBTFUL ({why})"
        case SourceIssue.NO_MODEL:
            return f"{note.path} does not say of which model it is a result"
        case SourceIssue.OTHER_BUILD:
            assert note.fmu is not None
            return f"{note.path} was made with another build of {note.fmu.name} than {note.fmu.path}"
