"""The verdict on a result in one line: grade, and the gravest reasons."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from fmuid.estimation import Doubt, Grade, Reason, Verdict
from fmuid.formatting import listed
from fmuid.reports.document import Message, Tone, plain
from fmuid.reports.topics.assumptions import defect_remedy, defect_words, error_remedy, error_words
from fmuid.reports.topics.solver_check import solver_remedy, unchecked_words

SHOWN_REASONS = 2  # reasons in the first line; the others are counted
STATES: dict[Grade, tuple[str, Tone]] = {
    Grade.PASSED: ("PASSED", "good"),
    Grade.DOUBTFUL: ("DOUBTFUL", "doubt"),
    Grade.NOT_USABLE: ("NOT USABLE", "bad"),
}
"""Word and tone of each grade."""


class VerdictMessage(Message):
    """Reasons of a verdict, the gravest first."""

    INTERRUPTED = plain("interrupted", remedy="Continue with `--resume`.")
    CONVENTION = plain("{defect}", remedy="Follow the message of the defect.")
    NOT_CONVERGED = plain("not converged: {first}", remedy="Follow the message of the termination.")
    NON_IDENTIFIABLE = plain(
        "{subjects} not identifiable", remedy="Fix one of them, add a prior, or use another excitation."
    )
    BETTER_OPTIMUM = plain("a better optimum exists near {subjects}", remedy="Identify again from there.")
    POOR_FIT = plain("{first} fits only {fit:.0f} %", remedy="Check the model.")
    LARGE_RESIDUAL = plain(
        "residual is {ratio:.2g} × noise level", remedy="Check the model, input interpolation and units."
    )
    SOLVER_UNCHECKED = "solver error unknown: {cause}"
    SOLVER_ERROR = "solver error moves {first} by {shift:.2g} σ"
    FEEDBACK = plain(
        "{first} follows the residual", remedy="Identify the loop from its reference, or check the clocks."
    )
    MODEL_ERROR = "{error}"
    DATA_DEFECT = plain("{defect}", remedy="Record again, or weight the samples.")
    EXPERIMENTS_CONFLICT = plain(
        "{first} contradicts the other experiments (p = {probability:.1g})",
        remedy="Check units, conditions and the model of this experiment.",
    )
    PRIOR_DATA_CONFLICT = plain(
        "prior and data conflict (p = {probability:.1g})", remedy="Check the prior, the model and the machine."
    )
    NOISE_LEVEL = plain("residual of {subjects} contradicts its stated noise level")
    INPUT_CORRELATION = plain(
        "model misses effects of {inputs}", remedy="Check interpolation, delay and unit of these inputs."
    )
    COLORED_RESIDUAL = plain(
        "residual of {subjects} is colored", remedy="Check the model structure and sensor filters."
    )
    PERIODIC_ERROR = plain("residual of {subjects} repeats with the excitation")
    LOW_FREQUENCY_NOISE = plain("residual of {subjects} has low-frequency noise")
    LONG_MEMORY = plain("noise of {subjects} is slow for its recording", remedy="Record longer.")
    OFFSET = plain("residual of {subjects} has an offset", remedy="Add an offset parameter.")
    DISTRIBUTION = plain("residual of {subjects} is not normal", remedy="Set a robust `loss`.")
    AT_BOUND = plain("{subjects} at a bound", remedy="Widen the bound or check the model.")
    WEAKLY_IDENTIFIABLE = plain("{subjects} weakly identifiable", remedy="Use a stronger excitation.")
    PRIOR_DOMINATED = plain("{subjects} identifiable only through the prior")
    SECOND_OPTIMUM = plain("a second optimum fits equally well", remedy="Narrow the bounds or add a prior.")
    NONLINEAR = plain("model nonlinear between prior and data", remedy="Compute a profile.")
    OBSERVER = plain("fit of predictions by an observer", remedy="Use a slower observer.")
    SAMPLING = plain("posterior samples did not converge", remedy="Raise `steps`.")
    MISSING_ROWS = plain("rows missing in {subjects}", remedy="Cut the data there.")
    ACQUISITION_DELAY = plain(
        "σ of {first} includes a delay within ±½ sample (× {widening:.2g})",
        remedy="Set `noise.delay_std = 0` if inputs and outputs are simultaneous.",
    )


def reason_words(verdict: Verdict) -> str:
    """Return the gravest reasons, and the number of others."""
    doubts = {each.subject for each in verdict.doubts if each.reason is Reason.MODEL_ERROR}
    free = (each for each in verdict.freed if each.reason is Reason.MODEL_ERROR and each.subject not in doubts)
    freed = [error_words(each) for each in free]
    told = [f"freed: {listed(freed)}"] if freed else []
    told += _phrases([*verdict.doubts, *(each for each in verdict.freed if each.reason is not Reason.MODEL_ERROR)])
    more = [f"{len(told) - SHOWN_REASONS} more"] if len(told) > SHOWN_REASONS else []
    return "; ".join([*told[:SHOWN_REASONS], *more])


def remedy_words(verdict: Verdict) -> str:
    """Return the remedy of the gravest reason that has one."""
    return next(filter(None, map(_remedy, (*verdict.doubts, *verdict.freed))), "")


def _remedy(found: Doubt) -> str:
    own = _REMEDIES[found.reason](found) if found.reason in _REMEDIES else ""
    return own or VerdictMessage[found.reason.name].remedy


def _phrases(found: Sequence[Doubt]) -> Iterator[str]:
    for reason, group in groupby(found, key=lambda each: each.reason):
        doubts = list(group)
        first = doubts[0]
        words = {
            "first": next(iter(first.subject), ""),
            "subjects": listed(_subjects(reason, doubts)),
            "cause": unchecked_words(first) if reason is Reason.SOLVER_UNCHECKED else "",
            "inputs": listed(list(dict.fromkeys(each.subject[2] for each in doubts if len(each.subject) > 2))),
            "defect": listed([defect_words(each) for each in doubts]) if reason in _DEFECTS else "",
            "error": listed([error_words(each) for each in doubts]) if reason is Reason.MODEL_ERROR else "",
        }
        yield VerdictMessage[reason.name].text.format_map({**first.values, **words})


def _subjects(reason: Reason, doubts: list[Doubt]) -> list[str]:
    names = (each.subject if reason in _DIRECTIONS else each.subject[:1] for each in doubts)
    return list(dict.fromkeys(name for each in names for name in each))


_REMEDIES = {
    Reason.MODEL_ERROR: error_remedy,
    Reason.SOLVER_UNCHECKED: solver_remedy,
    Reason.SOLVER_ERROR: solver_remedy,
    Reason.CONVENTION: defect_remedy,
    Reason.DATA_DEFECT: defect_remedy,
}
"""Remedies that depend on the doubt."""
_DEFECTS = {Reason.CONVENTION, Reason.DATA_DEFECT}
_DIRECTIONS = {Reason.NON_IDENTIFIABLE, Reason.WEAKLY_IDENTIFIABLE, Reason.PRIOR_DOMINATED, Reason.BETTER_OPTIMUM}
