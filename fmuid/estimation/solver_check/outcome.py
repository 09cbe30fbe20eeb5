"""What the check of a simulation found, and what was done about it, as values; `fmuid.reports` has the words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TypedDict

import numpy as np

from fmuid.array_types import Floats

SHIFT_LIMIT = 0.1
"""Standard deviations that estimates may be moved by: 95 % intervals then hold the truth in 94.9 % of all cases."""


class RunFields(TypedDict):
    """How an FMU is run: the fields of a `fmuid.models.SolverConfiguration`."""

    fmi_version: str
    interface: str
    integrator: str | None
    stiff: bool
    tolerance: float | None
    step_size: float | None
    divisor: int
    new_processes: bool


class _NamedModel(TypedDict):
    name: str
    digest: str


class UsedModel(_NamedModel, total=False):
    """Which FMU a result was made with, and how it was run."""

    run: RunFields


Runs = Mapping[str, RunFields]
"""How each component of a model is run."""


class AccuracyOutcome(Enum):
    """What became of the check of a simulation; the values are what ``result.json`` has as ``accuracy.outcome``."""

    PASSED = "passed"
    """Its error moves no estimate by more than `SHIFT_LIMIT`."""
    SHIFTED = "shifted"
    """It does, and what it moves them by is part of their standard deviations."""
    UNKNOWN = "unknown"
    """A standard deviation is infinite or not known, and with it what the error moves the estimates by."""
    UNCHECKABLE = "uncheckable"
    """Nothing finer is offered, or what should be finer gives the same outputs to the last bit."""
    COUPLED = "coupled"
    """How often components exchange their values moves an estimate, and nothing tells whether that is an error, or a
    sampled controller which would act more often."""
    FAILED = "failed"
    """The finer simulation fails."""
    INTERRUPTED = "interrupted"
    """By the keyboard."""


class RefinementRefusal(Enum):
    """Why a simulation that shifts the estimates serves all the same."""

    ASKED = "asked"
    """It is the one asked for."""
    FITS_BETTER = "fits_better"
    """The finer one fits the data clearly worse."""
    NO_SEARCH = "no_search"
    """A search by the finer one does not come to an end."""
    FINEST = "finest"
    """It is the finest that there is."""


class SwitchCause(Enum):
    """Why the search went by a finer simulation."""

    START_FAILED = "start_failed"
    """The simulation failed at the start, and the finer one does not."""
    START_DIFFERED = "start_differed"
    """At the start the outputs differed by more than a share of their spread."""
    SHIFT = "shift"
    """The estimates were moved by more than `SHIFT_LIMIT`, or perhaps so."""


@dataclass(frozen=True)
class RefinementStep:
    """A step to a finer simulation.

    Attributes
    ----------
    cause : SwitchCause
    size : float
        The largest difference of an output at the start, as a share of its spread, or the largest shift of an estimate,
        standard deviations; NaN where that is not known.
    before, after : mapping of str to mapping
        How each component was run, and then was: the fields of a `fmuid.models.SolverConfiguration`.
    simulations : int
        What the search that followed took.
    """

    cause: SwitchCause
    size: float
    before: Runs
    after: Runs
    simulations: int = 0


@dataclass(frozen=True, eq=False)
class SolverCheck:
    """What the error of the simulation does to the estimates, and what was done about it.

    Attributes
    ----------
    outcome : AccuracyOutcome
    shift : (N,) array
        What each estimate would move by if the finer simulation took the place of the one used, in its standard
        deviations; NaN where it is not known.
    used, finer : mapping of str to mapping
        How each component is run, and how it is in the check, as for `RefinementStep`; empty where there is none.
    change : float
        Norm of the difference of all outputs in standard deviations of their noise, which bounds what any estimate can
        be moved by; NaN without a check.
    kept : RefinementRefusal or None
        Why nothing finer serves where the estimates are shifted.
    switches : tuple of RefinementStep
    refused : int
        Optima of a search of the whole box that a finer simulation does not bear out.
    simulations : int
        What all of this took.
    tolerance, divisor : float or None, int
        How much finer than asked for the model is run (`fmuid.simulation.Refinement`).
    """

    outcome: AccuracyOutcome
    shift: Floats
    used: Runs = field(default_factory=dict)
    finer: Runs = field(default_factory=dict)
    change: float = math.nan
    kept: RefinementRefusal | None = None
    switches: tuple[RefinementStep, ...] = ()
    refused: int = 0
    simulations: int = 0
    tolerance: float | None = None
    divisor: int = 1

    @property
    def doubtful(self) -> bool:
        """Whether an error moves an estimate by more than `SHIFT_LIMIT`, or may where its shift is not known."""
        if self.outcome is AccuracyOutcome.COUPLED:
            return False
        unknown = bool(np.isnan(self.shift).any()) and self.change > SHIFT_LIMIT
        return self.largest > SHIFT_LIMIT or unknown

    @property
    def largest(self) -> float:
        """The largest shift that is known, standard deviations; NaN where none is."""
        known = np.abs(self.shift[np.isfinite(self.shift)])
        return float(known.max()) if known.size else math.nan
