"""Termination reason, starting points, discrete parameters, correlated estimates."""

from __future__ import annotations

import math
from collections import Counter

from fmuid.estimation import (
    CombinationFit,
    IdentifiabilityLevel,
    Result,
    SearchFailure,
    StartingPointSource,
    TerminationReason,
)
from fmuid.formatting import counted, with_unit
from fmuid.identification import EQUAL_COST
from fmuid.reports.document import Message, Remark, bad, doubt, plain
from fmuid.reports.shared_phrases import IdentifiabilityMessage, change_remark, direction_remark, prior_remark
from fmuid.reports.topics.solver_check import solver_remarks

ENDS = {
    TerminationReason.CONVERGED: "converged",
    TerminationReason.ACCURACY: "converged to solver accuracy",
    TerminationReason.UNDETERMINED: "not identifiable",
    TerminationReason.UNSETTLED: "noise variances do not settle",
    TerminationReason.ITERATION_LIMIT: "iteration limit reached",
    TerminationReason.RUNAWAY: "parameters diverge",
    TerminationReason.STALLED: "no step reduces the cost",
    TerminationReason.FAILING: "simulations fail nearby",
    TerminationReason.INTERRUPTED: "interrupted",
}
"""Termination reasons inside other sentences."""


class TerminationMessage(Message, section="cost"):
    """Why the optimization stopped."""

    CONVERGED = plain("Converged after {iterations}.", "a further step would gain less than a thousandth of σ")
    ACCURACY = plain(
        "Converged after {iterations}; solver accuracy limits further digits.",
        "below this the cost is irregular; mostly harmless",
        "Reduce `tolerance` or `step_size` for more digits.",
    )
    UNDETERMINED = bad("Not all parameters are identifiable.")
    UNSETTLED = bad("Not converged: noise variances do not settle.", remedy="Set `noise.variance`.")
    ITERATION_LIMIT = bad(
        "Not converged: limit of {iterations} reached.", remedy="Raise `max_iterations` or improve the initial guess."
    )
    RUNAWAY = bad(
        "Not converged: parameters diverge without improving the fit.",
        "too many parameters for these data",
        "Add bounds or a prior, improve the initial guess, or measure more.",
    )
    STALLED = bad(
        "Not converged: no step reduces the cost.",
        'events or a coarse solver; try `interface = "model-exchange"`',
        "Reduce solver `tolerance` or `step_size`, or change the initial guess.",
    )
    FAILING = bad(
        "Not converged: simulations fail near these values.",
        "often a unit is wrong",
        "Add bounds that exclude this region, or change the initial guess.",
    )
    INTERRUPTED = bad("Interrupted: best values so far.", remedy="Continue with `--resume`.")
    INTERRUPTED_SEARCH = bad(
        "Interrupted after {fits} of a global search: best values so far.", remedy="Continue with `--resume`."
    )
    AT_BOUND = doubt(
        "{name} is at its {end} bound {value}.",
        "the data would move it further; its interval is one-sided",
        "Widen the bound or check the model.",
    )
    EFFORT = plain("{iterations}, {simulations} simulations, {seconds} s; cost {cost}{likelihood}.")
    OBSERVER = doubt(
        "Observer with a memory of {memory} samples: predictions were fitted, not simulations.",
        "asked for by `estimation.observer_memory`; noise biases the estimates",
        "Repeat with a longer `observer_memory`; estimates that change show a bias.",
    )


class StartMessage(Message, section="cost"):
    """Starting points and discrete parameters."""

    RESTARTED = plain("Initial guess failed; restart {number} of {count} converged.")
    MODEL_ERROR = doubt(
        "Residual is {ratio} × noise level; all {count} starting points agree.",
        "not the initial guess: model, input or disturbance",
        "Check the model, input interpolation and units.",
    )
    LARGE_RESIDUAL = doubt(
        "Residual is {ratio} × noise level; {count} starting points fit no better.",
        remedy="Check the model and unmeasured disturbances, or improve the initial guess.",
    )
    NONE_CONVERGED = doubt(
        "None of {count} starting points converged.", remedy="Check bounds and model, or improve the initial guess."
    )
    ATTEMPTS = plain("Starting points: {attempts}.")
    REPLACED = plain("{name} has no effect at its initial guess; used {name} = {value} instead.")
    SIGN = doubt(
        "{name} changed sign, from {start} to {value}.", remedy="Add a bound at zero if the model requires one sign."
    )
    COMBINATION = plain("{values} fits best of {count} combinations.")
    NEXT = plain("Next best is {values}: −2 ln L is higher by {behind}.", "10 and more is clear")
    AMBIGUOUS = doubt(
        "{values} fits nearly as well: −2 ln L is higher by only {behind}.",
        remedy="Measure more, or with another excitation.",
    )
    NOT_STARTED = plain("{count} combinations could not be simulated, first {values}.")


def ending_remarks(result: Result) -> list[Remark]:
    """Return the termination reason, non-identifiable parameters and active bounds."""
    message, fits = TerminationMessage[result.outcome.name], result.history.fits
    values = {"iterations": counted(result.history.iterations, "iteration")}
    if result.outcome is TerminationReason.INTERRUPTED and fits is not None:
        message, values = TerminationMessage.INTERRUPTED_SEARCH, {"fits": counted(fits, "fit")}
    said = [message.said(**values)]
    for each in result.identifiability.non_identifiable:
        said.append(direction_remark(each))
        if len(each.names) > 2 and each.level is not IdentifiabilityLevel.NOT_IN_EFFECT:
            said.append(change_remark(each))
    for bound in result.estimates.at_bounds:
        i = result.names.index(bound.name)
        end = "lower" if bound.value == result.estimates.lower[i] else "upper"
        value = with_unit(bound.value, result.estimates.units.get(bound.name))
        said.append(TerminationMessage.AT_BOUND.said("", name=bound.name, end=end, value=value))
    return said


def state_and_reason(result: Result) -> tuple[str, str]:
    """Return the termination reason for the first line of a report."""
    iterations = counted(result.history.iterations, "iteration")
    match result.outcome:
        case _ if result.converged:
            return "converged", f"after {iterations}"
        case TerminationReason.UNDETERMINED:
            said = map(direction_remark, result.identifiability.non_identifiable)
            return "not identifiable", "; ".join(each.text.rstrip(".") for each in said)
        case TerminationReason.INTERRUPTED:
            return "interrupted", "best values so far"
        case TerminationReason.ITERATION_LIMIT:
            return "not converged", f"limit of {iterations}"
    return "not converged", ENDS[result.outcome]


def result_remarks(result: Result) -> list[Remark]:
    """Return all remarks on a result."""
    said, memory = ending_remarks(result), result.setup.observer
    said += [] if memory is None else [TerminationMessage.OBSERVER.said(memory=f"{memory:g}")]
    said += start_remarks(result)
    return [*said, *solver_remarks(result.names, result.accuracy), *dependence_remarks(result)]


def start_remarks(result: Result) -> list[Remark]:
    """Return the remarks on discrete parameters, initial guesses and restarts."""
    starts = list(zip(result.names, result.estimates.start.tolist(), result.values.tolist(), strict=True))
    moved = [
        StartMessage.REPLACED.said(name=name, value=f"{start:g}")
        for name, start, _ in starts
        if name in result.identifiability.replaced_initial_guess
    ]
    crossed = [
        StartMessage.SIGN.said(name=name, start=f"{start:.3g}", value=f"{value:.3g}")
        for name, start, value in starts
        if start * value < 0 and not result.converged
    ]
    return [*moved, *_combinations(result), *_attempts(result), *crossed]


def dependence_remarks(result: Result) -> list[Remark]:
    """Return the remarks on correlated and weakly identifiable estimates."""
    pairs = [
        IdentifiabilityMessage.CORRELATED.said(one=one, other=other, correlation=f"{value:+.3f}")
        for one, other, value in result.estimates.strong_correlations
    ]
    weak = map(direction_remark, result.identifiability.weakly_identifiable)
    return [*pairs, *weak, *map(prior_remark, result.identifiability.prior_dominated)]


def effort_remark(result: Result) -> Remark:
    """Return iterations, simulations, time and cost."""
    spent, likelihood = result.history, result.fit.log_likelihood
    return TerminationMessage.EFFORT.said(
        iterations=counted(spent.iterations, "iteration"),
        simulations=spent.simulations,
        seconds=f"{spent.elapsed_s:.2f}",
        cost=f"{result.fit.cost:.6g}",
        likelihood=f", log-likelihood {likelihood:.7g}" if math.isfinite(likelihood) else "",
    )


PLACES = {
    StartingPointSource.GIVEN: "initial guess",
    StartingPointSource.EQUATION_ERROR: "equation-error estimate",
    StartingPointSource.CORRECTION: "corrected simulation",
    StartingPointSource.SOBOL: "point of the box",
}
"""Origins of starting points."""

TROUBLES = {
    SearchFailure.NONE: "converged",
    SearchFailure.FAR: "skipped, worse than the mean",
    SearchFailure.FAILED: "simulation failed",
    SearchFailure.NO_EFFECT: "a parameter has no effect",
    SearchFailure.UNFINISHED: "not converged",
    SearchFailure.LARGE_RESIDUAL: "residual {ratio:.3g} × noise level",
    SearchFailure.MODEL_ERROR: "residual {ratio:.3g} × noise level",
}
"""What became of them."""


def _combinations(result: Result) -> list[Remark]:
    """Return the best combination of discrete parameters, and the next best."""
    if not result.history.combinations:
        return []
    best, *others = result.history.combinations
    failed = [each for each in others if each.outcome is None]
    said = [StartMessage.COMBINATION.said("", values=_values(best), count=len(result.history.combinations))]
    if len(others) > len(failed):
        message = StartMessage.AMBIGUOUS if others[0].behind < EQUAL_COST else StartMessage.NEXT
        said.append(message.said("", values=_values(others[0]), behind=f"{others[0].behind:.3g}"))
    if failed:
        said.append(StartMessage.NOT_STARTED.said("", count=len(failed), values=_values(failed[0])))
    return said


def _values(each: CombinationFit) -> str:
    said = {name: str(value).lower() if isinstance(value, bool) else value for name, value in each.values.items()}
    return ", ".join(f"{name} = {value}" for name, value in said.items())


def _attempts(result: Result) -> list[Remark]:
    tried = result.history.restarts
    if not tried:
        return []
    kept = next((k for k, each in enumerate(tried) if each.kept), None)
    trouble = SearchFailure.UNFINISHED if kept is None else tried[kept].trouble
    message = {
        SearchFailure.NONE: StartMessage.RESTARTED,
        SearchFailure.MODEL_ERROR: StartMessage.MODEL_ERROR,
        SearchFailure.LARGE_RESIDUAL: StartMessage.LARGE_RESIDUAL,
    }.get(trouble, StartMessage.NONE_CONVERGED)
    ends = Counter(
        f"{PLACES[each.remedy]} ({TROUBLES[each.trouble].format(ratio=each.noise_ratio)}{', used' * each.kept})"
        for each in tried
    )
    attempts = ", ".join(one if times == 1 else f"{times} × {one}" for one, times in ends.items())
    values = {"ratio": "" if kept is None else f"{tried[kept].noise_ratio:.3g}", "number": kept}
    count = len(tried) - (message is StartMessage.RESTARTED)
    return [message.said(count=count, **values), StartMessage.ATTEMPTS.said(attempts=attempts)]
