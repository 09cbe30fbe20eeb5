"""How a search ended, what it leaves open, which starts it tried, and what to do."""

from __future__ import annotations

import math
from itertools import groupby
from typing import TYPE_CHECKING

from fmuid.estimation import (
    CombinationFit,
    Identifiability,
    RestartAttempt,
    SearchFailure,
    StartingPointSource,
    TerminationReason,
)
from fmuid.formatting import listed
from fmuid.identification import RIVAL_CRITERION
from fmuid.reports.document import Remark, capitalised
from fmuid.reports.shared_phrases import direction_words
from fmuid.reports.topics.solver_check import accuracy_words, passed_words

if TYPE_CHECKING:
    from fmuid.estimation import Result

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


_FINER = ", or make the simulation more accurate (step_size, tolerance, interface)"


def result_words(result: Result) -> tuple[str, ...]:
    """Return all that is to be said of a result: how it ended first, then what the estimates do not show."""
    return ending(result), *remarks(result)


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


# --- starts ---------------------------------------------------------------------------------

PLACES = {
    StartingPointSource.GIVEN: "the start that was given",
    StartingPointSource.EQUATION_ERROR: "where the model's equations hold best at the measured states",
    StartingPointSource.CORRECTION: "where simulations fit best that the measurements correct at each sample",
    StartingPointSource.SOBOL: "a point of the box",
}
"""Where a search set out from."""

TROUBLES = {
    SearchFailure.NONE: "ended well",
    SearchFailure.FAR: "was put off, for it explains too little of the data",
    SearchFailure.FAILED: "could not be simulated",
    SearchFailure.NO_EFFECT: "could not be searched from",
    SearchFailure.UNFINISHED: "did not come to an end",
    SearchFailure.LARGE_RESIDUAL: "left {ratio:.3g} times the noise that the data show",
    SearchFailure.MODEL_ERROR: "left {ratio:.3g} times the noise that the data show",
}
"""What became of it."""


def combination_words(result: Result) -> tuple[str, ...]:
    """Return which values fit best of parameters that take few, and how far the next best is."""
    if not result.combinations:
        return ()
    best, *others = result.combinations
    failed = [each for each in others if each.outcome is None]
    said = f"{_values(best)} fits best of {len(result.combinations)} combinations"
    if len(others) > len(failed):
        behind = others[0].behind
        said += f"; the next best, {_values(others[0])}, is behind by {behind:.3g} in −2 ln L"
        if behind < RIVAL_CRITERION:
            said += ": the data hardly tell which of the two is true, measure more"
    if failed:
        said += f"; {len(failed)} could not be searched with, {_values(failed[0])} first"
    return (said,)


def _values(each: CombinationFit) -> str:
    said = {name: str(value).lower() if isinstance(value, bool) else value for name, value in each.values.items()}
    return ", ".join(f"{name} = {value}" for name, value in said.items())


def attempt_words(result: Result) -> tuple[str, ...]:
    """Return which starts were tried, what became of each and which is kept; nothing where the first one did."""
    if not result.attempts:
        return ()
    each_told = groupby(f"{PLACES[each.remedy]} {_end(each)}" for each in result.attempts)
    counts = ((one, len(list(alike))) for one, alike in each_told)
    told = [one if count == 1 else f"{one} ({count} times)" for one, count in counts]
    kept = next((each for each in result.attempts if each.kept), None)
    if kept is None or kept.trouble is SearchFailure.NONE:
        return (f"several starts were tried: {listed(told)}",)
    if kept.trouble is SearchFailure.MODEL_ERROR:
        reason = "; the model does not explain the data, other starts end there too: check the model and its inputs"
        return (f"several starts were tried: {listed(told)}{reason}",)
    if kept.trouble is SearchFailure.LARGE_RESIDUAL:
        reason = "; other starts fit no better: look at the model, or at what else moves the outputs"
        return (f"several starts were tried: {listed(told)}{reason}",)
    return (f"several starts were tried: {listed(told)}; none ended well",)


def _end(attempt: RestartAttempt) -> str:
    words = TROUBLES[attempt.trouble].format(ratio=attempt.noise_ratio)
    return f"{words}, which is kept" if attempt.kept else words


# --- remarks --------------------------------------------------------------------------------


def result_remarks(result: Result) -> list[Remark]:
    """Return what the estimates do not show by themselves, with the sections that show it."""
    said = [(text, "criterion", True) for text in (*observer_words(result), *start_words(result))]
    if result.accuracy is not None:
        passed = passed_words(result.accuracy)
        said += [(passed, "accuracy", False)] if passed else []
        doubtful = result.accuracy.doubtful
        said += [(text, "accuracy", doubtful) for text in accuracy_words(result.names, result.accuracy)]
    said += [(text, "correlation", True) for text in dependence_words(result)]
    return [Remark(capitalised(text, result.names), "doubt" if doubt else "plain", key) for text, key, doubt in said]
