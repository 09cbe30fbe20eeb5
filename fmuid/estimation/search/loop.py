"""The loop of every search: frozen states, one after the other, until one has an outcome."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np

from fmuid.array_types import Flags, Floats


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


class ResidualFunction(Protocol):
    """A residual (n_rows,) as a function of theta (N,); `fmuid.estimation.cost_function.CostFunction` is one."""

    @property
    def lower(self) -> Floats:
        """Lower bounds (N,)."""

    @property
    def upper(self) -> Floats:
        """Upper bounds (N,)."""

    @property
    def noise(self) -> float:
        """Root mean square of the noise that the residual itself has, that of the simulation."""

    def magnitudes(self, theta: Floats) -> Floats:
        """Return how large each parameter is (N,)."""

    def residuals(self, thetas: Floats) -> Floats:
        """Return (m, n_rows) for thetas (m, N), NaN rows where failed."""

    def jacobian(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the derivative (n_rows, N), by forward or by central differences."""

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the norm of the error in each of its columns (N,)."""

    def measure_noise(self, theta: Floats, residual: Floats, steps: Floats) -> tuple[float, bool]:
        """Measure the simulation's noise anew, in steps (N,), and use it; return that of ‖residual‖² and if it grew."""


@dataclass(frozen=True, eq=False)
class Iteration:
    """One step of the search; the first one, number 0, is the start.

    Attributes
    ----------
    number : int
    criterion : float
        ‖residual‖² at theta, NaN where the simulation failed.
    damping : float
        λ of the step, relative to D² (0: a Gauss–Newton step, NaN at the start).
    accepted : bool
    theta : (N,) array
        The point tried.
    step : float
        Length of the step relative to the parameters' magnitudes.
    offset : float
        What was left of the way before the step, in standard deviations.
    central : bool
        Whether the step came from central differences.
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
    """What a search knows after a step.

    Attributes
    ----------
    theta, residual : arrays
        The best point and the residual there.
    jacobian : (n_rows, N) array
        The one in use.
    central : bool
        Whether it is by central differences.
    fresh : bool
        Whether it was made at theta.
    iterations : int
        Steps tried so far.
    rate : float
        By which the last Gauss–Newton steps came nearer to the optimum.
    outcome : TerminationReason or None
        How the search ended, None while it has not.
    borrowed : bool
        Whether the Jacobian is that of a point close by.
    held : (N,) array of bool
        Parameters on a bound that the criterion would push further out.
    reduced : (N+1, N+1) array or None
        The triangle [R q] of the Jacobian in use and a residual; None where it is not known yet.
    last : Iteration or None
        The step that led here; None where the search ended without one.
    memory : object
        What else the method remembers.
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
    """A method of search: frozen settings with two functions."""

    def begin(self, function: ResidualFunction, state: State) -> State:
        """Return the state from which the search sets out: it has residual and Jacobian."""

    def advance(self, function: ResidualFunction, state: State) -> State:
        """Return the state after one more step, or with an outcome."""


def iterate(search: Search, function: ResidualFunction, state: State) -> Iterator[State]:
    """Search from a state; yield it and all that follow, the last of which has an outcome.

    Parameters
    ----------
    search : Search
    function : ResidualFunction
    state : State
        It has residual and Jacobian.
    """
    state = search.begin(function, state)
    yield state
    while state.outcome is None:
        state = search.advance(function, state)
        yield state


def last_state(search: Search, function: ResidualFunction, state: State) -> State:
    """Search from a state to the end, and return what it comes to."""
    for each in iterate(search, function, state):
        state = each
    return state
