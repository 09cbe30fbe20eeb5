"""The verdict on a result in one line: grade, and the gravest reasons."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from fmuid.estimation import Doubt, Grade, Reason, Verdict
from fmuid.formatting import listed
from fmuid.reports.document import Message, Tone
from fmuid.reports.topics.assumptions import defect_remedy, defect_words, error_remedy, error_words
from fmuid.reports.topics.solver_check import unchecked_words

SHOWN_REASONS = 2  # reasons in the first line; the others are counted
STATES: dict[Grade, tuple[str, Tone]] = {
    Grade.PASSED: ("PASSED", "good"),
    Grade.DOUBTFUL: ("DOUBTFUL", "doubt"),
    Grade.NOT_USABLE: ("NOT USABLE", "bad"),
}
"""Word and tone of each grade."""


class VerdictMessage(Message):
    """Reasons of a verdict, the gravest first."""

    INTERRUPTED = ("interrupted", "by Ctrl-C: the best values so far", "Continue with `--resume`.")
    NOT_CONVERGED = ("not converged: {first}", "no minimum was found", "Follow the message of the termination.")
    NON_IDENTIFIABLE = (
        "{subjects} not identifiable",
        "the data do not determine these parameters, or only a combination",
        "Fix one of them, add a prior, or use another excitation.",
    )
    BETTER_OPTIMUM = (
        "a better optimum exists near {subjects}",
        "a profile or a cost map found a lower cost",
        "Identify again from there.",
    )
    POOR_FIT = ("{first} fits only {fit:.0f} % (NRMSE)", "the model explains less than half", "Check the model.")
    LARGE_RESIDUAL = (
        "residual is {ratio:.2g} × noise level",
        "the model does not explain the data from any starting point",
        "Check the model, input interpolation and units.",
    )
    SOLVER_UNCHECKED = (
        "solver error unknown: {cause}",
        "no more accurate simulation",
        "Export the FMU for Model Exchange.",
    )
    SOLVER_ERROR = (
        "solver error moves {first} by {shift:.2g} σ",
        "σ includes it",
        "Leave `interface`, `tolerance` and `solver_check` unset.",
    )
    FEEDBACK = (
        "{first} follows the residual",
        "a closed loop, whose noise biases estimates, or outputs that run ahead of the inputs",
        "Identify the loop from its reference, or check the clocks.",
    )
    MODEL_ERROR = ("{error}", "a directed test names this model error", "Follow the message of the model error.")
    DATA_DEFECT = (
        "{defect}",
        "the record itself biases estimates or intervals",
        "Record again, or weight the samples.",
    )
    EXPERIMENTS_CONFLICT = (
        "{first} contradicts the other experiments (p = {probability:.1g})",
        "its own estimates differ from theirs",
        "Check units, conditions and the model of this experiment.",
    )
    PRIOR_DATA_CONFLICT = (
        "prior and data conflict (p = {probability:.1g})",
        "prior, model or machine differ",
        "Check the prior, the model and the machine.",
    )
    NOISE_LEVEL = ("residual of {subjects} contradicts its stated noise level", "the stated σ is wrong, or the model")
    INPUT_CORRELATION = (
        "model misses effects of {inputs}",
        "the residual is correlated with inputs",
        "Check interpolation, delay and unit of these inputs.",
    )
    COLORED_RESIDUAL = (
        "residual of {subjects} is colored",
        "dynamics of the noise, or of the machine that the model does not have",
        "Check the model structure and sensor filters.",
    )
    PERIODIC_ERROR = ("residual of {subjects} repeats with the excitation", "model error; σ includes it")
    LOW_FREQUENCY_NOISE = ("residual of {subjects} has low-frequency noise", "noise or model error; σ includes it")
    LONG_MEMORY = ("noise of {subjects} is slow for its recording", "σ is uncertain", "Record longer.")
    OFFSET = ("residual of {subjects} has an offset", "of a sensor, or of the model", "Add an offset parameter.")
    DISTRIBUTION = ("residual of {subjects} is not normal", "outliers, or asymmetric noise", "Set a robust `loss`.")
    AT_BOUND = ("{subjects} at a bound", "the data point beyond it", "Widen the bound or check the model.")
    WEAKLY_IDENTIFIABLE = ("{subjects} weakly identifiable", "σ above the scale", "Use a stronger excitation.")
    PRIOR_DOMINATED = ("{subjects} identifiable only through the prior", "the data alone do not determine them")
    SECOND_OPTIMUM = ("a second optimum fits equally well", "the data allow both", "Narrow the bounds or add a prior.")
    NONLINEAR = ("model nonlinear between prior and data", "local σ is an order of magnitude", "Compute a profile.")
    OBSERVER = ("fit of predictions by an observer", "measurement noise biases it", "Use a slower observer.")
    SAMPLING = ("posterior samples did not converge", "credible intervals are unreliable", "Raise `steps`.")
    MISSING_ROWS = ("rows missing in {subjects}", "inputs are interpolated", "Cut the data there.")
    ACQUISITION_DELAY = (
        "σ of {first} includes a delay within ±½ sample (× {widening:.2g})",
        "channels need not be read at one instant; this delay dominates σ",
        "Set `noise.delay_std = 0` if inputs and outputs are simultaneous.",
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
    first = next(iter((*verdict.doubts, *verdict.freed)), None)
    if first is not None and first.reason is Reason.MODEL_ERROR:
        return error_remedy(first)
    if first is not None and first.reason is Reason.DATA_DEFECT and (own := defect_remedy(first)):
        return own
    told = [each.reason for each in (*verdict.doubts, *verdict.freed)]
    return next((text for each in told if (text := VerdictMessage[each.name].remedy)), "")


def _phrases(found: Sequence[Doubt]) -> Iterator[str]:
    for reason, group in groupby(found, key=lambda each: each.reason):
        doubts = list(group)
        first = doubts[0]
        words = {
            "first": next(iter(first.subject), ""),
            "subjects": listed(_subjects(reason, doubts)),
            "cause": unchecked_words(first) if reason is Reason.SOLVER_UNCHECKED else "",
            "inputs": listed(list(dict.fromkeys(each.subject[2] for each in doubts if len(each.subject) > 2))),
            "defect": listed([defect_words(each) for each in doubts]) if reason is Reason.DATA_DEFECT else "",
            "error": listed([error_words(each) for each in doubts]) if reason is Reason.MODEL_ERROR else "",
        }
        yield VerdictMessage[reason.name].text.format_map({**first.values, **words})


def _subjects(reason: Reason, doubts: list[Doubt]) -> list[str]:
    names = (each.subject if reason in _DIRECTIONS else each.subject[:1] for each in doubts)
    return list(dict.fromkeys(name for each in names for name in each))


_DIRECTIONS = {Reason.NON_IDENTIFIABLE, Reason.WEAKLY_IDENTIFIABLE, Reason.PRIOR_DOMINATED, Reason.BETTER_OPTIMUM}
