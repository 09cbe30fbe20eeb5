"""Agreement of searches from different starts: two that end at one place tell that the model is wrong, not the start.

They agree where their criteria are the same within chance, and their estimates too, along all that is determined. An
agreement far above the noise may still be a secondary optimum. There the equations of the model are asked: where they
hold far better at the measured states than the simulation fits, the model can explain the data, and a third search
decides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fmuid.estimation import MAX_NOISE_RATIO, RestartAttempt, Result, SearchFailure, StartingPointSource
from fmuid.identification.equation_error_start import POOR
from fmuid.identification.solver_checked_search import RIVAL_CRITERION

# Estimates agree where they differ by less than so many standard deviations.
SAME_PLACE = 1.0


@dataclass(frozen=True, eq=False)
class EndedSearch:
    """A search that came to an end.

    Attributes
    ----------
    result : Result
    attempt : RestartAttempt
    number : int
        Of the attempt.
    worth : float
        Σ K_j log σ̂_j², by which results of any variances compare.
    """

    result: Result
    attempt: RestartAttempt
    number: int
    worth: float


def is_confirmed(one: EndedSearch, ended: Sequence[EndedSearch], equation_ratio: float = math.nan) -> bool:
    """Return whether other searches confirm a bad fit as the best of the model.

    Parameters
    ----------
    one : EndedSearch
    ended : sequence of EndedSearch
        All, `one` among them or not.
    equation_ratio : float
        Root mean square of the equations' residual at the measured states by its noise; NaN where it is unknown.
    """
    if one.attempt.trouble is not SearchFailure.LARGE_RESIDUAL:
        return False
    confirmed = sum(_agree(one, other) for other in ended if other.number != one.number)
    ratio = one.attempt.noise_ratio
    is_explicable = ratio > POOR and ratio > MAX_NOISE_RATIO * equation_ratio
    return confirmed > (1 if is_explicable else 0)


def _agree(one: EndedSearch, other: EndedSearch) -> bool:
    """Return whether two searches from independent starts ended at the same optimum."""
    # corrections set out from the start that was given: the two confirm nothing of each other
    if {one.attempt.remedy, other.attempt.remedy} == {StartingPointSource.GIVEN, StartingPointSource.CORRECTION}:
        return False
    if other.attempt.trouble is not SearchFailure.LARGE_RESIDUAL or not abs(one.worth - other.worth) <= RIVAL_CRITERION:
        return False
    std = np.fmax(one.result.std, other.result.std)
    apart = np.abs(one.result.values - other.result.values)
    return bool((apart <= np.where(np.isfinite(std), SAME_PLACE * std, np.inf)).all())
