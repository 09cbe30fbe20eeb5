"""What is to be said of a result: how its search ended, what it leaves open, and what to do about it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from fmuid.estimation import Identifiability, TerminationReason
from fmuid.formatting import fit_text, two_digits, with_unit
from fmuid.identification import TimeScaleMismatch
from fmuid.reports.messages.accuracy import accuracy_words
from fmuid.reports.messages.identifiability import direction_words
from fmuid.reports.messages.restarts import attempt_words, combination_words
from fmuid.studies import SourceIssue

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from fmuid.estimation import Result
    from fmuid.identification import TimeScaleWarning
    from fmuid.runs import IdentificationRun
    from fmuid.simulation import OutputFit
    from fmuid.studies import SourceWarning

CONSTANT = "constant as measured: no fit"
"""What is said in place of a fit that has no meaning."""
ENDS = {
    TerminationReason.CONVERGED: "converged",
    TerminationReason.ACCURACY: (
        "converged to the accuracy of the simulation: make it more accurate (step_size, its tolerance) for more digits"
    ),
    TerminationReason.UNDETERMINED: "undetermined",
    TerminationReason.UNSETTLED: (
        "the noise variances still move from one repetition of the search to the next: give them as noise.variance"
    ),
    TerminationReason.ITERATION_LIMIT: "stopped at the iteration limit: raise max_iterations or start nearer",
    TerminationReason.RUNAWAY: (
        "stopped: parameters run away by orders of magnitude, and the fit gains nothing by it: "
        "give a prior, bounds or a start nearer by, or measure more"
    ),
    TerminationReason.STALLED: (
        "stalled: no step lowers the criterion although its slope says so; "
        "make the simulation more accurate (step_size, its tolerance) or start elsewhere"
    ),
    TerminationReason.FAILING: (
        "stopped at the edge of what can be simulated, every step that would lower the criterion fails: "
        "give bounds that keep the search where the model is sound, or start elsewhere"
    ),
    TerminationReason.INTERRUPTED: "interrupted: these are the best values so far",
}
"""How a search ended, and what to do about it."""


SHOWN_DROPOUTS = 3

_FINER = ", or make the simulation more accurate (step_size, tolerance, interface)"


def result_words(result: Result) -> tuple[str, ...]:
    """Return all that is to be said of a result: how it ended first, then what the estimates do not show."""
    return ending(result), *remarks(result)


def finding_remarks(found: IdentificationRun) -> tuple[str, ...]:
    """Return the sentences on tables and estimates that the numbers do not show by themselves."""
    return *(dropout_words(*each) for each in found.dropouts.items()), *remarks(found.result)


def ending(result: Result) -> str:
    """Return how an identification ended and, where that is needed, the remedy."""
    words = [ENDS[result.outcome] + (_so_far(result) if result.outcome is TerminationReason.INTERRUPTED else "")]
    if result.undetermined:
        told = (
            "; ".join(map(direction_words, result.undetermined))
            + ": give a prior, hold one of them at a value, or measure more"
            + (_FINER if any(each.determined is Identifiability.HIDDEN for each in result.undetermined) else "")
        )
        words = [f"{words[0]}: {told}"] if result.outcome is TerminationReason.UNDETERMINED else [*words, told]
    if result.at_bounds:
        bounds = "; ".join(f"{each.name} is at its bound {each.value:g}" for each in result.at_bounds)
        words.append(f"{bounds}, and the data would move it further: widen the bound or check the model")
    return "; ".join(words)


def _so_far(result: Result) -> str:
    if result.fits is None:
        return ""
    return f" of a global search, after {result.fits} fit{'' if result.fits == 1 else 's'}"


def remarks(result: Result) -> tuple[str, ...]:
    """Return the sentences on what the estimates do not show by themselves."""
    accuracy = accuracy_words(result.names, result.accuracy)
    return *observer_words(result), *start_words(result), *accuracy, *dependence_words(result)


def observer_words(result: Result) -> tuple[str, ...]:
    """Return what an observer makes of a result."""
    if result.observer is None:
        return ()
    return (
        f"an observer with its poles at {result.observer:g} samples kept the simulation with the record: this is a fit "
        "of predictions over about that time, not of the output error, and noise of the measurements biases it the "
        "more, the faster the observer is",
    )


def start_words(result: Result) -> tuple[str, ...]:
    """Return the sentences on starts that were no starts, and on signs that a search in vain has changed."""
    moved = [
        f"{name} changes no output at the start that was given: the search set out from {name} = {result.start[i]:g}"
        for i, name in enumerate(result.names)
        if name in result.moved_start
    ]
    crossed = [
        f"{name} began at {start:.3g} and has come to {value:.3g}: give it a bound if the model holds on one side of "
        "zero only"
        for name, start, value in zip(result.names, result.start.tolist(), result.values.tolist(), strict=True)
        if start * value < 0 and not result.converged
    ]
    return *moved, *combination_words(result), *attempt_words(result), *crossed


def dependence_words(result: Result) -> tuple[str, ...]:
    """Return the sentences on estimates that depend on each other, on next to nothing, or on the prior."""
    pairs = [
        f"estimates of {one} and {other} move together (correlation {share:+.3f}): intervals do not hold one by one"
        for one, other, share in result.strong_correlations
    ]
    prior = [f"without the prior, {direction_words(each)}" for each in result.prior_determined]
    return *pairs, *map(direction_words, result.weak), *prior


def effort_words(result: Result) -> str:
    """Return what the search took, and the criterion that it ended at."""
    likelihood = f", log-likelihood {result.log_likelihood:.7g}" if math.isfinite(result.log_likelihood) else ""
    return (
        f"{result.iterations} iterations, {result.simulations} simulations, {result.elapsed_s:.2f} s; criterion "
        f"{result.criterion:.6g}{likelihood}"
    )


def capitalised(words: str, names: Iterable[str] = ()) -> str:
    """Return words with a capital at their beginning; one of these names that stands there is kept as it is."""
    kept = any(words.startswith(name) and not words[len(name) :][:1].isalnum() for name in names)
    return words if kept else words[0].upper() + words[1:]


def dropout_words(source: str, times: Sequence[float]) -> str:
    """Return where rows of a table are missing, by the times before, s, and what is made of that."""
    some = ", ".join(f"{time:.6g}" for time in times[:SHOWN_DROPOUTS]) + (", …" if len(times) > SHOWN_DROPOUTS else "")
    return f"{source}: rows are missing after t = {some} s; inputs go on there as between any samples"


def time_words(doubt: TimeScaleWarning) -> str:
    """Return why the unit of a record's time is to be looked at."""
    lasts = f"{doubt.source} lasts {doubt.duration:.3g} s in steps of {doubt.step:.3g} s"
    look = 'look at the unit of its time, and say it by time_unit = "ms" or what it is'
    match doubt.kind:
        case TimeScaleMismatch.TOO_LONG:
            return f"{lasts}, and what the model does is over in {doubt.time_constant:.2g} s (ms?): {look}"
        case TimeScaleMismatch.TOO_SHORT:
            return f"{lasts}, and the model takes {doubt.time_constant:.2g} s for what it does (s, not ms?): {look}"


def size_words(source: str, column: str, ratio: float) -> str:
    """Return why the units of a record are to be looked at: so many times as far moves the model at its own values."""
    return (
        f"{source}: at the FMU's own values what {column!r} measures moves {two_digits(ratio)} times as far as "
        'measured: look at the units of its column and of the inputs\', and say them by units, as in U = "mV"'
    )


def source_words(note: SourceWarning) -> str:
    """Return why an earlier result, of which something is taken, is to be taken with care."""
    match note.doubt:
        case SourceIssue.DID_NOT_SUCCEED:
            return f"{note.path}, an earlier result, did not succeed: {note.outcome.value}"
        case SourceIssue.NO_MODEL:
            return f"{note.path} does not say of which model it is a result"
        case SourceIssue.OTHER_BUILD:
            assert note.fmu is not None
            return f"{note.path} was made with another build of {note.fmu.name} than {note.fmu.path}"


def fit_words(fits: Sequence[OutputFit]) -> str:
    """Return the fit and RMSE of each output of each experiment, as far as it was measured."""
    said = []
    for each in fits:
        scores = zip(each.outputs, each.fit, each.rmse, each.units, each.counted.T, strict=True)
        told = [f"{name} {_score(fit, rmse, unit)}" for name, fit, rmse, unit, counted in scores if counted.any()]
        if told:
            said.append((f"{each.experiment}: " if len(fits) > 1 else "") + ", ".join(told))
    return "; ".join(said)


def _score(fit: float, rmse: float, unit: str | None) -> str:
    error = f"RMSE {with_unit(rmse, unit)}"
    return f"{error} ({CONSTANT})" if math.isnan(fit) and math.isfinite(rmse) else f"{fit_text(fit)} ({error})"
