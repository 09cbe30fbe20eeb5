"""Loop of every optimization: frozen states until one has an outcome."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np

from fmuid.array_types import Flags, Floats


class TerminationReason(Enum):
    """Termination reason; the values stand in ``result.json`` as ``outcome``."""

    CONVERGED = "converged"  # at a minimum, within the tolerance
    ACCURACY = "accuracy"  # at a minimum, as far as the simulation's accuracy shows it
    UNDETERMINED = "undetermined"  # a minimum, or a runaway, along directions that are not identifiable
    UNSETTLED = "unsettled"  # all fits converged, but the noise variances still change
    ITERATION_LIMIT = "iteration_limit"  # maximum number of steps
    RUNAWAY = "runaway"  # parameters grew by orders of magnitude without gain
    STALLED = "stalled"  # no step reduces the cost, in spite of its slope
    FAILING = "failing"  # every step that could reduce the cost fails
    INTERRUPTED = "interrupted"  # by the keyboard, at the best values so far

    @property
    def converged(self) -> bool:
        """True at a minimum with all parameters identifiable."""
        return self in (TerminationReason.CONVERGED, TerminationReason.ACCURACY)


class ResidualFunction(Protocol):
    """Residual (n_rows,) as a function of theta (N,), such as `CostFunction`."""

    @property
    def lower(self) -> Floats:
        """Lower bounds (N,)."""

    @property
    def upper(self) -> Floats:
        """Upper bounds (N,)."""

    @property
    def noise(self) -> float:
        """RMS of the simulation noise in the residual."""

    def magnitudes(self, theta: Floats) -> Floats:
        """Return the magnitudes (N,) of the parameters."""

    def residuals(self, thetas: Floats) -> Floats:
        """Return (m, n_rows) for thetas (m, N), NaN rows if failed."""

    def jacobian(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the derivative (n_rows, N), by forward or by central differences."""

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the norm of the error in each of its columns (N,)."""

    def measure_noise(self, theta: Floats, residual: Floats, steps: Floats) -> tuple[float, bool]:
        """Measure the noise in steps (N,); return that of ‖residual‖², and growth."""


@dataclass(frozen=True, eq=False)
class Iteration:
    """One step of the optimization; number 0 is the initial guess.

    Attributes
    ----------
    number : int
    criterion : float
        Cost at theta, NaN if the simulation failed.
    damping : float
        λ of the step, relative to D²; 0 for Gauss–Newton, NaN at the initial guess.
    accepted : bool
    theta : (N,) array
        Trial point.
    step : float
        Length of the step relative to the magnitudes.
    offset : float
        Remaining distance before the step, σ.
    central : bool
        True with central differences.
    """

    number: int
    criterion: float
    damping: float
    accepted: bool
    theta: Floats
    step: float
    offset: float
    central: bool


@dataclass(frozen=True, eq=False)
class State:
    """State of an optimization after a step.

    Attributes
    ----------
    theta, residual : arrays
        Best point and its residual.
    jacobian : (n_rows, N) array
        Jacobian in use.
    central : bool
        True if the Jacobian is by central differences.
    fresh : bool
        True if the Jacobian belongs to theta.
    iterations : int
        Number of trial steps.
    rate : float
        Convergence rate of the last Gauss–Newton steps.
    outcome : TerminationReason or None
        None before the end.
    borrowed : bool
        True if the Jacobian belongs to a neighboring cell center.
    held : (N,) array of bool
        Parameters that the cost pushes against a bound.
    reduced : (N+1, N+1) array or None
        Triangle [R q] of Jacobian and residual, if known.
    last : Iteration or None
        Last step.
    memory : object
        Private state of the method.
    """

    theta: Floats
    residual: Floats
    jacobian: Floats
    central: bool = True
    fresh: bool = True
    iterations: int = 0
    rate: float = 1.0
    outcome: TerminationReason | None = None
    borrowed: bool = False
    held: Flags = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    reduced: Floats | None = None
    last: Iteration | None = None
    memory: object = None


class Search(Protocol):
    """Optimizer: frozen settings with two functions."""

    def begin(self, function: ResidualFunction, state: State) -> State:
        """Return the first state."""

    def advance(self, function: ResidualFunction, state: State) -> State:
        """Return the state after one step, or with an outcome."""


def iterate(search: Search, function: ResidualFunction, state: State) -> Iterator[State]:
    """Yield all states from a given one on; the last has an outcome."""
    state = search.begin(function, state)
    yield state
    while state.outcome is None:
        state = search.advance(function, state)
        yield state


def last_state(search: Search, function: ResidualFunction, state: State) -> State:
    """Optimize from a state; return the last one."""
    for each in iterate(search, function, state):
        state = each
    return state
