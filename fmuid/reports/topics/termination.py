"""Termination reason, identifiability, restarts, remedies."""

from __future__ import annotations

import math
from itertools import groupby

from fmuid.estimation import (
    CombinationFit,
    IdentifiabilityLevel,
    Result,
    SearchFailure,
    StartingPointSource,
    TerminationReason,
)
from fmuid.formatting import listed
from fmuid.identification import RIVAL_CRITERION
from fmuid.reports.document import Remark, capitalised
from fmuid.reports.shared_phrases import direction_words
from fmuid.reports.topics.solver_check import accuracy_words, passed_words

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
    """Return the termination reason and all remarks."""
    return ending(result), *remarks(result)


def ending(result: Result) -> str:
    """Return the termination reason and the remedy."""
    words = [ENDS[result.outcome]]
    if result.outcome is TerminationReason.INTERRUPTED and result.history.fits is not None:
        words[0] += f" of a global search, after {result.history.fits} fit{'' if result.history.fits == 1 else 's'}"
    if open_ := result.identifiability.non_identifiable:
        told = (
            "; ".join(map(direction_words, open_))
            + ": give a prior, hold one of them at a value, or measure more"
            + (_FINER if any(each.level is IdentifiabilityLevel.HIDDEN for each in open_) else "")
        )
        words = [f"{words[0]}: {told}"] if result.outcome is TerminationReason.UNDETERMINED else [*words, told]
    if result.estimates.at_bounds:
        bounds = "; ".join(f"{each.name} is at its bound {each.value:g}" for each in result.estimates.at_bounds)
        words.append(f"{bounds}, and the data would move it further: widen the bound or check the model")
    return "; ".join(words)


def remarks(result: Result) -> tuple[str, ...]:
    """Return the remarks on a result."""
    accuracy = accuracy_words(result.names, result.accuracy)
    return *observer_words(result), *start_words(result), *accuracy, *dependence_words(result)


def observer_words(result: Result) -> tuple[str, ...]:
    """Return the remark on an observer."""
    if result.setup.observer is None:
        return ()
    return (
        f"an observer with its poles at {result.setup.observer:g} samples kept the simulation with the record: this is "
        "a fit of predictions over about that time, not of the output error, and noise of the measurements biases it "
        "the more, the faster the observer is",
    )


def start_words(result: Result) -> tuple[str, ...]:
    """Return the remarks on initial guesses and restarts."""
    starts = list(zip(result.names, result.estimates.start.tolist(), strict=True))
    moved = [
        f"{name} changes no output at the start that was given: the search set out from {name} = {start:g}"
        for name, start in starts
        if name in result.identifiability.replaced_initial_guess
    ]
    crossed = [
        f"{name} began at {start:.3g} and has come to {value:.3g}: give it a bound if the model holds on one side of "
        "zero only"
        for (name, start), value in zip(starts, result.values.tolist(), strict=True)
        if start * value < 0 and not result.converged
    ]
    return *moved, *combination_words(result), *attempt_words(result), *crossed


def dependence_words(result: Result) -> tuple[str, ...]:
    """Return the remarks on correlated and weakly identifiable estimates."""
    pairs = [
        f"estimates of {one} and {other} move together (correlation {share:+.3f}): intervals do not hold one by one"
        for one, other, share in result.estimates.strong_correlations
    ]
    prior = [f"without the prior, {direction_words(each)}" for each in result.identifiability.prior_dominated]
    return *pairs, *map(direction_words, result.identifiability.weakly_identifiable), *prior


def effort_words(result: Result) -> str:
    """Return iterations, simulations, time and cost."""
    spent = result.history
    likelihood = f", log-likelihood {result.fit.log_likelihood:.7g}" if math.isfinite(result.fit.log_likelihood) else ""
    return (
        f"{spent.iterations} iterations, {spent.simulations} simulations, {spent.elapsed_s:.2f} s; criterion "
        f"{result.fit.cost:.6g}{likelihood}"
    )


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
KEPT_START = {
    SearchFailure.NONE: "",
    SearchFailure.MODEL_ERROR: (
        "; the model does not explain the data, other starts end there too: check the model and its inputs"
    ),
    SearchFailure.LARGE_RESIDUAL: "; other starts fit no better: look at the model, or at what else moves the outputs",
}
"""What the start that is kept tells."""


def combination_words(result: Result) -> tuple[str, ...]:
    """Return the best combination of discrete parameters."""
    if not result.history.combinations:
        return ()
    best, *others = result.history.combinations
    failed = [each for each in others if each.outcome is None]
    said = f"{_values(best)} fits best of {len(result.history.combinations)} combinations"
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
    """Return the restarts and their outcome."""
    if not result.history.restarts:
        return ()
    each_told = groupby(
        f"{PLACES[each.remedy]} {TROUBLES[each.trouble].format(ratio=each.noise_ratio)}{', which is kept' * each.kept}"
        for each in result.history.restarts
    )
    counts = ((one, len(list(alike))) for one, alike in each_told)
    told = [one if count == 1 else f"{one} ({count} times)" for one, count in counts]
    kept = next((each for each in result.history.restarts if each.kept), None)
    reason = "" if kept is None else KEPT_START.get(kept.trouble, "; none ended well")
    return (f"several starts were tried: {listed(told)}{reason}",)


def result_remarks(result: Result) -> list[Remark]:
    """Return the remarks on a result with their sections."""
    said = [(text, "criterion", True) for text in (*observer_words(result), *start_words(result))]
    if result.accuracy is not None:
        passed = passed_words(result.accuracy)
        said += [(passed, "accuracy", False)] if passed else []
        doubtful = result.accuracy.doubtful
        said += [(text, "accuracy", doubtful) for text in accuracy_words(result.names, result.accuracy)]
    said += [(text, "correlation", True) for text in dependence_words(result)]
    return [Remark(capitalised(text, result.names), "doubt" if doubt else "plain", key) for text, key, doubt in said]
