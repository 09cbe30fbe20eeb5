"""What is to be said of the starts that a search tried, in one sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fmuid.estimation import Attempt, Remedy, Trouble
from fmuid.text import listed

if TYPE_CHECKING:
    from fmuid.estimation import Result

PLACES = {
    Remedy.GIVEN: "the start that was given",
    Remedy.EQUATION_ERROR: "where the model's equations hold best at the measured states",
    Remedy.CORRECTION: "where simulations fit best that the measurements correct at each sample",
    Remedy.SOBOL: "a point of the box",
}
"""Where a search set out from."""

ENDS = {
    Trouble.NONE: "ended well",
    Trouble.FAR: "was put off, for it explains too little of the data",
    Trouble.FAILED: "could not be simulated",
    Trouble.NO_EFFECT: "could not be searched from",
    Trouble.UNFINISHED: "did not come to an end",
    Trouble.MISFIT: "left {misfit:.3g} times the noise that the data show",
}
"""What became of it."""


def attempt_words(result: Result) -> tuple[str, ...]:
    """Return which starts were tried, what became of each and which is kept; nothing where the first one did."""
    if not result.attempts:
        return ()
    told = [f"{PLACES[each.remedy]} {_end(each)}" for each in result.attempts]
    kept = next((each for each in result.attempts if each.kept), None)
    if kept is None or kept.trouble is Trouble.NONE:
        return (f"several starts were tried: {listed(told)}",)
    if kept.trouble is Trouble.MISFIT:
        reason = "; other starts fit no better: look at the model, or at what else moves the outputs"
        return (f"several starts were tried: {listed(told)}{reason}",)
    return (f"several starts were tried: {listed(told)}; none ended well",)


def _end(attempt: Attempt) -> str:
    words = ENDS[attempt.trouble].format(misfit=attempt.misfit)
    return f"{words}, which is kept" if attempt.kept else words
