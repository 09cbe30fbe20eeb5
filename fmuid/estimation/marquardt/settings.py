"""What goes into a search for the least sum of squares, and what comes out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from fmuid.array_types import Flags, Floats
from fmuid.errors import InputError
from fmuid.estimation.marquardt.outcome import TerminationReason

# Most problems need 5 to 20 steps; the most crooked of the NIST reference problems (Bennett5) need several hundred.
MAX_ITERATIONS = 1000
# The search ends where no parameter has more than this share of its magnitude left to go: six digits.
TOLERANCE = 1e-6
# Length of the first step against the parameters themselves, both measured by D.
FIRST_RADIUS = 1.0


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


@dataclass(frozen=True)
class MarquardtSettings:
    """The numbers that a search goes by; `fmuid.Marquardt`, which has them, documents them."""

    max_iterations: int = MAX_ITERATIONS
    tolerance: float = TOLERANCE
    first_radius: float = FIRST_RADIUS

    def __post_init__(self) -> None:
        for name in ("max_iterations", "tolerance", "first_radius"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                raise InputError(f"the setting {name} of the search must be a positive number, not {value!r}")


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


@dataclass(eq=False)
class State:
    """What the search knows; it stays valid when the search is interrupted.

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
        Whether the Jacobian is that of a waypoint close by.
    held : (N,) array of bool
        Parameters on a bound that the criterion would push further out.
    reduced : (N+1, N+1) array or None
        The triangle [R q] of the Jacobian in use and a residual; None where it is not known yet.
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
