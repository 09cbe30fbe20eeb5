"""What is to be said of the error of the simulation: what it does to the estimates, and what was done about it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from fmuid.estimation import SHIFT_LIMIT, AccuracyOutcome, RefinementRefusal, SwitchCause
from fmuid.reports.messages.solver import runs_words

if TYPE_CHECKING:
    from fmuid.estimation import RefinementStep, SolverCheck

KEPT = {
    RefinementRefusal.ASKED: "it is simulated as it was asked for: "
    "leave interface, tolerance and accuracy open for a finer search",
    RefinementRefusal.FITS_BETTER: "the finer simulation fits clearly worse, "
    "as if the table came from this very solver",
    RefinementRefusal.NO_SEARCH: "a search by the finer simulation does not end",
    RefinementRefusal.FINEST: "there is no finer simulation to go on by",
}
"""Why a simulation that shifts the estimates serves all the same."""
LEAST_SHOWN = 0.005
"""Standard deviations: a smaller shift is none to a reader."""


def accuracy_words(names: Sequence[str], found: SolverCheck | None) -> tuple[str, ...]:
    """Return the sentences on a simulation that cannot be taken for exact, or was not to begin with.

    Parameters
    ----------
    names : sequence of str
        The parameters, in the order of `SolverCheck.shift`.
    found : SolverCheck or None
    """
    if found is None:
        return ()
    finer = runs_words(found.finer)
    refused = (
        f"{_optima(found.refused)} fitted as well, and the finer simulation ({finer}) moves away from "
        f"{'it' if found.refused == 1 else 'them'}: refused"
    )
    words = [*map(_switch, found.switches), *([refused] if found.refused else []), _outcome(names, found)]
    return tuple(filter(None, words))


def passed_words(found: SolverCheck) -> str:
    """Return the sentence on a simulation that has passed its check, nothing for others."""
    if found.outcome is not AccuracyOutcome.PASSED or not found.finer:
        return ""
    checked = f"simulation checked by {runs_words(found.finer)}"
    if math.isnan(found.largest):  # no estimate has a standard deviation
        return f"{checked}: it changes the outputs by {found.change:.1g} standard deviations in all"
    return f"{checked}: it moves the estimates by {max(found.largest, LEAST_SHOWN):.1g} std at most"


def _optima(count: int) -> str:
    return "another optimum" if count == 1 else f"{count} other optima"


def _switch(switch: RefinementStep) -> str:
    before, after = runs_words(switch.before), runs_words(switch.after)
    if switch.cause is SwitchCause.START_FAILED:
        return f"simulated by {before} the start fails: the search went by {after}"
    if switch.cause is SwitchCause.START_DIFFERED:
        return (
            f"at the start {before} is off by {100 * switch.size:.2g} % of an output's spread: the search went "
            f"by {after}"
        )
    moved = (
        f"moves an estimate by {switch.size:.2g} standard deviations"
        if switch.size > SHIFT_LIMIT
        else "may move an estimate whose standard deviation is not known"
    )
    return f"the error of {before} {moved}: the search went on by {after}, in {switch.simulations} simulations"


def _outcome(names: Sequence[str], found: SolverCheck) -> str:
    used, finer = runs_words(found.used), runs_words(found.finer)
    match found.outcome:
        case AccuracyOutcome.PASSED:
            return ""
        case AccuracyOutcome.SHIFTED:
            why = KEPT.get(found.kept, "") if found.kept else ""
            return (
                "the error of the simulation moves estimates, in the standard deviations of noise: "
                f"{_shifts(names, found)} ({finer} against {used}); that is added to the standard deviations; {why}"
            )
        case AccuracyOutcome.UNKNOWN:
            return (
                "what the error of the simulation moves the estimates by is not known, as not all have a standard "
                f"deviation; {finer} changes the outputs by {found.change:.2g} standard deviations in all"
            )
        case AccuracyOutcome.UNCHECKABLE:
            why = (
                "in shorter steps the FMU gives the same outputs to the last bit, as it steps inside at its own length"
                if found.finer
                else "nothing finer is offered"
            )
            return f"the error of the simulation cannot be checked: {why}"
        case AccuracyOutcome.COUPLED:
            return (
                "the error of the simulation is not known: a quarter of the communication step would move "
                f"{_shifts(names, found)} (standard deviations), and the FMUs do not tell whether for less error or "
                "because a sampled controller would act more often; give samples = true for the components that act "
                "once a step, or samples = false where none does"
            )
        case AccuracyOutcome.FAILED:
            return f"the error of the simulation is not known: {finer} fails at the estimates"
        case AccuracyOutcome.INTERRUPTED:
            return "the error of the simulation was not checked: interrupted"


def _shifts(names: Sequence[str], found: SolverCheck) -> str:
    """Return which estimates are moved, and by how much; just that they may be where no standard deviation is known."""
    pairs = zip(names, found.shift.tolist(), strict=True)
    moved = ", ".join(f"{name} by {shift:+.2g}" for name, shift in pairs if abs(shift) > SHIFT_LIMIT)
    return moved or f"the outputs by {found.change:.2g} in all"


def shift_text(shift: float) -> str:
    """Return a shift in standard deviations for a table, a question mark where it is not known."""
    if math.isnan(shift):
        return "?"
    return f"{shift:+.2f}" if abs(shift) >= LEAST_SHOWN else "0"
