"""What is to be said of the starts that a search tried, in one sentence."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from fmuid.estimation import CombinationFit, RestartAttempt, SearchFailure, StartingPointSource
from fmuid.formatting import listed
from fmuid.identification import RIVAL_CRITERION

if TYPE_CHECKING:
    from fmuid.estimation import Result

PLACES = {
    StartingPointSource.GIVEN: "the start that was given",
    StartingPointSource.EQUATION_ERROR: "where the model's equations hold best at the measured states",
    StartingPointSource.CORRECTION: "where simulations fit best that the measurements correct at each sample",
    StartingPointSource.SOBOL: "a point of the box",
}
"""Where a search set out from."""

ENDS = {
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
    words = ENDS[attempt.trouble].format(ratio=attempt.noise_ratio)
    return f"{words}, which is kept" if attempt.kept else words
