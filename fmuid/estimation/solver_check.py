"""Outcome of the solver check."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TypedDict

import numpy as np

from fmuid.array_types import Floats

SHIFT_LIMIT = 0.1  # largest solver error, σ: 95 % intervals then cover 94.9 %


class RunFields(TypedDict):
    """Simulation settings of an FMU: fields of a `fmuid.models.SolverConfiguration`."""

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
    """FMU of a result, with its simulation settings."""

    run: RunFields


Runs = Mapping[str, RunFields]  # simulation settings of each component


class AccuracyOutcome(Enum):
    """Outcome of a solver check; ``accuracy.outcome`` in ``result.json``."""

    PASSED = "passed"  # no estimate moves by more than `SHIFT_LIMIT`
    SHIFTED = "shifted"  # one does; the standard deviations contain the solver error
    UNKNOWN = "unknown"  # a standard deviation is infinite or unknown
    UNCHECKABLE = "uncheckable"  # nothing finer is available, or its outputs are identical to the last bit
    COUPLED = "coupled"  # the communication step matters: an error, or a sampled controller
    FAILED = "failed"  # the finer simulation fails
    INTERRUPTED = "interrupted"  # by the keyboard


class RefinementRefusal(Enum):
    """Reason to keep a simulation that shifts the estimates."""

    ASKED = "asked"  # as requested
    FITS_BETTER = "fits_better"  # the finer one fits the data clearly worse
    NO_SEARCH = "no_search"  # no fit with the finer one terminates
    FINEST = "finest"  # nothing finer is available


class SwitchCause(Enum):
    """Reason for a solver refinement."""

    START_FAILED = "start_failed"  # the simulation failed at the initial guess, the finer one does not
    START_DIFFERED = "start_differed"  # the outputs differed at the initial guess
    SHIFT = "shift"  # the solver error exceeds `SHIFT_LIMIT`, or may do so


@dataclass(frozen=True)
class RefinementStep:
    """One solver refinement.

    Attributes
    ----------
    cause : SwitchCause
    size : float
        Largest output difference (share of its spread) or shift (σ); NaN if unknown.
    before, after : mapping of str to mapping
        Simulation settings of each component.
    simulations : int
        Simulations of the fit that followed.
    """

    cause: SwitchCause
    size: float
    before: Runs
    after: Runs
    simulations: int = 0


@dataclass(frozen=True, eq=False)
class SolverCheck:
    """Solver error of the estimates, and refinements made.

    Attributes
    ----------
    outcome : AccuracyOutcome
    shift : (N,) array
        Shift of each estimate by the finer simulation, σ; NaN if unknown.
    used, finer : mapping of str to mapping
        Simulation settings of each component, in use and in the check.
    change : float
        Norm of all output differences, σ of the noise; bounds every shift. NaN without check.
    kept : RefinementRefusal or None
        Reason to keep a simulation that shifts the estimates.
    switches : tuple of RefinementStep
    refused : int
        Optima that a finer simulation does not confirm.
    simulations : int
        Simulations of the check.
    tolerance, divisor : float or None, int
        Refinement in use (`fmuid.simulation.Refinement`).
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
        """True if a solver error exceeds `SHIFT_LIMIT`, or may do so."""
        if self.outcome is AccuracyOutcome.COUPLED:
            return False
        unknown = bool(np.isnan(self.shift).any()) and self.change > SHIFT_LIMIT
        return self.largest > SHIFT_LIMIT or unknown

    @property
    def largest(self) -> float:
        """Largest known shift, σ; NaN if none is known."""
        known = np.abs(self.shift[np.isfinite(self.shift)])
        return float(known.max()) if known.size else math.nan
