"""What is to be known of the ends of a profile, as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from fmuid.estimation import ActiveBound, TerminationReason


class EndKind(Enum):
    """What is to be known of an end of a profile."""

    BOUND = "bound"
    """It is the parameter's own bound."""
    FLAT = "flat"
    """No end: the criterion does not rise."""
    FAILING = "failing"
    """It is not known: beyond, simulations fail."""
    NOT_CONVERGED = "not_converged"
    """On the way a search for the other parameters did not converge."""
    IMPRECISE = "imprecise"
    """It could not be found more precisely."""
    LOWER = "lower"
    """No end: the criterion is lower than at the estimate."""
    OTHER_AT_BOUND = "other_at_bound"
    """There another parameter is at its bound."""


@dataclass(frozen=True)
class ProfileEndNote:
    """What is to be known of one end of a profile.

    Attributes
    ----------
    kind : EndKind
    upper : bool
        Which end.
    value : float
        Of the parameter, where it happens.
    rise : float
        Of the criterion there, above its least value.
    outcome : TerminationReason or None
        How the search for the others ended, where it did not converge.
    other : ActiveBound or None
        The other parameter that is at its bound.
    """

    kind: EndKind
    upper: bool
    value: float
    rise: float
    outcome: TerminationReason | None = None
    other: ActiveBound | None = None
