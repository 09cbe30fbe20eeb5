"""A point at which a search ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from fmuid import codec
from fmuid.array_types import Floats
from fmuid.estimation.search.loop import TerminationReason


@dataclass(frozen=True, eq=False)
class Optimum:
    """A point at which searches from other starts ended too, or instead.

    Attributes
    ----------
    theta : (N,) array
    criterion : float
        J_C (1.37) there; where noise variances are estimated, with those of the best optimum.
    hits : int
        How many of the fits ended here.
    outcome : TerminationReason
        How the best of these fits ended.
    fit : Result or None
        That fit; None where it was read from a file.
    """

    theta: Floats
    criterion: float
    hits: int
    outcome: TerminationReason
    fit: Any = field(default=None, repr=False)

    json_layout: ClassVar = codec.Layout(omitted={"fit"}, derived=("converged",))

    @property
    def converged(self) -> bool:
        """Whether it is a minimum with every parameter determined."""
        return self.outcome.converged
