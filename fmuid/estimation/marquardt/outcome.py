"""How a search or an identification ended, as a value; `fmuid.reports` has the words for it."""

from __future__ import annotations

from enum import Enum


class TerminationReason(Enum):
    """How a search ended; the values are what ``result.json`` has as ``outcome``."""

    CONVERGED = "converged"
    """At a minimum, to the tolerance asked for."""
    ACCURACY = "accuracy"
    """At a minimum as far as the accuracy of the simulation lets it be seen."""
    UNDETERMINED = "undetermined"
    """At a minimum, or running away, along directions that neither data nor prior determine."""
    UNSETTLED = "unsettled"
    """Every search converged, and the noise variances of one still differ from those of the next."""
    ITERATION_LIMIT = "iteration_limit"
    """After as many steps as were allowed."""
    RUNAWAY = "runaway"
    """With parameters that grew by orders of magnitude while the fit gained nothing by it."""
    STALLED = "stalled"
    """Where no step lowers the criterion although its slope says so."""
    FAILING = "failing"
    """Where every step that would lower the criterion fails."""
    INTERRUPTED = "interrupted"
    """By the keyboard, at the best values so far."""

    @property
    def converged(self) -> bool:
        """Whether the point is a minimum, as far as the simulation can tell, that determines every parameter."""
        return self in (TerminationReason.CONVERGED, TerminationReason.ACCURACY)
