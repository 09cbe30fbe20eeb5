"""Equation error and instrumental variables, without simulation (docs/method/linear-models.md).

The filter's lags z_j′ = λ (z_{j−1} − z_j) are integrated exactly between samples; their states give derivatives, Dᵖ z_m
= λᵖ Σ_i C(p, i) (−1)^(p−i) z_{m−i}. References: P. C. Young, Int. J. Control 23 (5), 1976; H. Garnier, L. Wang (ed.),
"Identification of Continuous-time Models from Sampled Data", 2008, chapter 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import special

from fmuid.array_types import Floats, numbers
from fmuid.blas import single_threaded
from fmuid.errors import InputError, check_kind
from fmuid.estimation.linear import Estimator, LinearEstimate, solve
from fmuid.formatting import nearest

INTERPOLATIONS = ("linear", "zoh")


@dataclass(frozen=True)
class EquationErrorSettings:
    """Limits of terms, and convergence of instruments."""

    most_derivatives: int = 20  # more are mistyped
    longest_gap: float = 5.0  # time constants of the filter; interpolation over more is no information
    settled: float = 1e-3  # share of σ that instruments may still move the estimates ...
    rounding: float = 1e-9  # ... or, without noise, share of the estimates
    most_rounds: int = 20  # of new instruments


SETTINGS = EquationErrorSettings()


@dataclass(frozen=True, eq=False)
class Term:
    """Signal in a differential equation, or its derivative.

    Parameters
    ----------
    values : (K,) array
        Samples of the signal, NaN if missing.
    derivative : int
        Order of the derivative; 0 is the signal.
    interpolation : "linear" or "zoh"
        Between samples.

    Examples
    --------
    >>> from fmuid.estimation import Term, equation_error
    >>> times = np.linspace(0.0, 10.0, 1001)
    >>> terms = {"a": Term(np.exp(-2.0 * times))}
    >>> rate = Term(np.exp(-2.0 * times), derivative=1)
    >>> equation_error(times, rate, terms, cutoff=5.0).values.round(2)
    array([-2.])
    """

    values: ArrayLike
    derivative: int = 0
    interpolation: str = "linear"

    def __post_init__(self) -> None:
        if self.interpolation not in INTERPOLATIONS:
            near = nearest(str(self.interpolation), INTERPOLATIONS)
            raise InputError(f"interpolation {self.interpolation!r} is unknown{near}. Choose linear or zoh.")
        if self.derivative not in range(SETTINGS.most_derivatives + 1):
            raise InputError(f"derivative must be 0, 1, ... {SETTINGS.most_derivatives}, not {self.derivative!r}")
        object.__setattr__(self, "derivative", int(self.derivative))


class StateVariableFilter:
    """Filter (λ/(s + λ))ᵐ over given times, λ the cutoff in rad/s."""

    def __init__(self, times: ArrayLike, cutoff: float, order: int) -> None:
        clock = numbers(times, "times")
        if clock.ndim != 1 or clock.size < 2 or not np.isfinite(clock).all() or not (np.diff(clock) > 0).all():
            raise InputError("times must be two or more finite numbers that increase from each to the next")
        if not (isinstance(cutoff, int | float | np.integer | np.floating) and math.isfinite(cutoff) and cutoff > 0):
            raise InputError(f"cutoff must be a positive number of rad/s, not {cutoff!r}")
        if order not in range(1, SETTINGS.most_derivatives + 2):
            raise InputError(f"order must be 1, 2, ... {SETTINGS.most_derivatives + 1}, not {order!r}")
        self.times, self.cutoff, self.order = clock, float(cutoff), int(order)
        self._steps = self._transitions()

    def _transitions(self) -> Floats:
        """Return each step's transition (K − 1, m, m + 2): states, signal, its change."""
        m, x = self.order, self.cutoff * np.diff(self.times)
        number, ahead = np.arange(1, m + 1), np.subtract.outer(np.arange(m), np.arange(m))
        found = np.zeros((x.size, m, m + 2))
        step = special.gammainc(number, x[:, None])
        found[:, :, m] = step  # a ramp gives P(i, x) − i P(i + 1, x)/x
        found[:, :, m + 1] = step - number * special.gammainc(number + 1, x[:, None]) / x[:, None]
        lower = ahead >= 0
        held, along = ahead[lower], x[:, None]
        found[:, :, :m][:, lower] = np.exp(special.xlogy(held, along) - along - special.gammaln(held + 1))
        return found

    def columns(self, terms: Sequence[Term]) -> Floats:
        """Return filtered terms (K, n_terms), from rest."""
        signals = np.column_stack([self._filled(term) for term in terms])
        held = np.array([term.interpolation == "zoh" for term in terms])
        m, inner = self.order, np.zeros((self.order + 2, len(terms)))
        states = np.zeros((self.times.size, m + 1, len(terms)))
        states[:, 0] = signals
        changes = np.where(held, 0.0, np.diff(signals, axis=0))
        for k, step in enumerate(self._steps):
            inner[:m], inner[m], inner[m + 1] = states[k, 1:], signals[k], changes[k]
            np.matmul(step, inner, out=states[k + 1, 1:])
        return np.column_stack([self._derivative(states[:, :, i], term.derivative) for i, term in enumerate(terms)])

    def _derivative(self, states: Floats, p: int) -> Floats:
        parts = [math.comb(p, i) * (-1.0) ** (p - i) * states[:, self.order - i] for i in range(p + 1)]
        return np.asarray(self.cutoff**p * np.sum(parts, axis=0), dtype=np.float64)

    def _filled(self, term: Term) -> Floats:
        if term.derivative > self.order:
            raise InputError(
                f"a filter of order {self.order} has no derivative {term.derivative}. Give a higher order."
            )
        values = numbers(term.values, "the values of a term")
        if values.shape != self.times.shape:
            raise InputError(
                f"a term needs {self.times.size} values, one for each of the times; its shape is {values.shape}"
            )
        there = ~np.isnan(values)
        if not there.any() or not np.isfinite(values[there]).all():
            raise InputError("a term needs finite values; NaN is a missing sample")
        if there.all():
            return values
        known = np.concatenate([self.times[:1], self.times[there], self.times[-1:]])
        at = int(np.argmax(np.diff(known)))
        if known[at + 1] - known[at] > max(SETTINGS.longest_gap / self.cutoff, 2.0 * float(np.diff(self.times).max())):
            raise InputError(
                f"a term has no sample from {known[at]:g} to {known[at + 1]:g} s, over {SETTINGS.longest_gap:g} "
                "time constants of the filter. Exclude that part."
            )
        if term.interpolation == "zoh":
            return np.asarray(pd.Series(values).ffill().bfill(), dtype=np.float64)
        return np.asarray(np.interp(self.times, self.times[there], values[there]), dtype=np.float64)

    def start_terms(self) -> Floats:
        """Return normalized terms tᵏ e^(−λt) of unknown initial derivatives (K, ≤ m)."""
        phase = self.cutoff * (self.times - self.times[0])
        columns = phase[:, None] ** np.arange(self.order) * np.exp(-phase)[:, None]
        lengths = np.linalg.norm(columns, axis=0)
        return np.asarray(columns[:, lengths > 0] / lengths[lengths > 0], dtype=np.float64)


@single_threaded
def equation_error(
    times: ArrayLike, target: Term, terms: Mapping[str, Term], *, cutoff: float, order: int | None = None
) -> LinearEstimate:
    """Estimate D^p0 s_0 = Σ θ_j D^pj s_j by filtered least squares.

    Use it as initial guess of `identify`. Noise in the terms biases it; `instrumental_variables` has no bias.

    Parameters
    ----------
    times : (K,) array
        Increasing, s.
    target : Term
        Left side, such as the voltage in R i + L di/dt = u.
    terms : mapping of str to Term
        Term of each parameter.
    cutoff : float
        λ of the filter (λ/(s + λ))^order, rad/s; near the inverse of the main time constant.
    order : int, optional
        Default: highest derivative plus one.

    Returns
    -------
    LinearEstimate

    Raises
    ------
    InputError
        If terms do not fit times or filter, or are linearly dependent.

    Examples
    --------
    A coil of 4 Ω and 0.1 H from rest at 1 V:

    >>> import numpy as np, fmuid
    >>> t = np.arange(0.0, 0.2, 1e-3)
    >>> i = (1.0 - np.exp(-t / 0.025)) / 4.0
    >>> terms = {"R": fmuid.estimation.Term(i), "L": fmuid.estimation.Term(i, derivative=1)}
    >>> voltage = fmuid.estimation.Term(np.ones_like(t), interpolation="zoh")
    >>> fmuid.estimation.equation_error(t, voltage, terms, cutoff=40.0).values.round(3)
    array([4. , 0.1])
    """
    equation = _Equation(times, target, terms, cutoff, order)
    return solve(Estimator.EQUATION_ERROR, equation.names, equation.rows, equation.values)


@single_threaded
def instrumental_variables(
    times: ArrayLike,
    target: Term,
    terms: Mapping[str, Term],
    simulated: Callable[[Floats], Mapping[str, Term]],
    *,
    cutoff: float,
    order: int | None = None,
    start: ArrayLike | None = None,
) -> LinearEstimate:
    """Estimate D^p0 s_0 = Σ θ_j D^pj s_j with simulated terms as instruments.

    Parameters
    ----------
    times, target, terms, cutoff, order
        As for `equation_error`.
    simulated : callable
        Theta (N,) to the terms with simulated outputs; a simulation from the inputs alone.
    start : (N,) array, optional
        First theta to simulate; default: the estimate of `equation_error`.

    Returns
    -------
    LinearEstimate
        After at most 20 rounds; see `LinearEstimate.converged`.

    Raises
    ------
    InputError
        As `equation_error`, and if simulated terms are missing or not finite.

    Examples
    --------
    >>> from fmuid.estimation import Term, instrumental_variables
    >>> times = np.linspace(0.0, 5.0, 501)
    >>> u = np.sign(np.sin(3.0 * times))
    >>> def simulated(theta):
    ...     y = np.zeros(times.size)
    ...     for k in range(times.size - 1):
    ...         y[k + 1] = y[k] + 0.01 * (theta[0] * y[k] + theta[1] * u[k])
    ...     return {"a": Term(y), "b": Term(u, interpolation="zoh")}
    >>> y = simulated([-2.0, 4.0])["a"].values + 0.05 * np.random.default_rng(0).standard_normal(times.size)
    >>> terms = {"a": Term(y), "b": Term(u, interpolation="zoh")}
    >>> instrumental_variables(times, Term(y, derivative=1), terms, simulated, cutoff=10.0).values.round(1)
    array([-2.,  4.])
    """
    equation = _Equation(times, target, terms, cutoff, order)
    if start is None:
        theta = solve(Estimator.EQUATION_ERROR, equation.names, equation.rows, equation.values).values
    else:
        theta = numbers(start, "start")
        if theta.shape != (len(equation.names),):
            raise InputError(f"start needs {len(equation.names)} values, one a parameter; its shape is {theta.shape}")
    check_kind(simulated, Callable, "simulated must be a function of theta that returns the terms")  # type: ignore[arg-type]
    kind, rounds, settled = Estimator.INSTRUMENTAL_VARIABLES, 0, False
    while not settled and rounds < SETTINGS.most_rounds:
        instruments = equation.made_of(simulated(theta.copy()), theta)
        found = solve(kind, equation.names, equation.rows, equation.values, instruments)
        most = SETTINGS.settled * found.std + SETTINGS.rounding * np.abs(theta)
        settled = bool((np.abs(found.values - theta) <= most).all())
        theta, rounds = found.values, rounds + 1
    return replace(found, rounds=rounds, converged=settled)


class _Equation:
    """Filtered equation: regressors with free initial terms, and target."""

    def __init__(
        self, times: ArrayLike, target: Term, terms: Mapping[str, Term], cutoff: float, order: int | None
    ) -> None:
        _check_terms(terms, "terms")
        check_kind(target, Term, "target must be a fmuid.estimation.Term(values)")
        if not terms:
            raise InputError("terms are missing. Give a term for each parameter.")
        highest = max(term.derivative for term in (target, *terms.values()))
        self.filter = StateVariableFilter(times, cutoff, highest + 1 if order is None else order)
        self.names = tuple(terms)
        self.free = self.filter.start_terms()
        columns = self.filter.columns([*terms.values(), target])
        self.rows, self.values = np.column_stack([columns[:, :-1], self.free]), columns[:, -1]

    def made_of(self, terms: Mapping[str, Term], theta: Floats) -> Floats:
        """Return the regressors (K, N + free) of terms simulated at theta (N,)."""
        _check_terms(terms, "what simulated returns")
        for name in self.names:
            if name not in terms:
                raise InputError(f"the simulated terms have none for {name!r}{nearest(name, terms)}")
            if not np.isfinite(numbers(terms[name].values, f"the simulated term of {name!r}")).all():
                values = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.names, theta.tolist(), strict=True))
                raise InputError(f"the simulated term of {name!r} is not finite with {values}. Give another start.")
        return np.column_stack([self.filter.columns([terms[name] for name in self.names]), self.free])


def _check_terms(terms: Mapping[str, Term], what: str) -> None:
    check_kind(terms, Mapping, f"{what} must be a mapping of parameters to fmuid.estimation.Term(values)")
    for name, term in terms.items():
        check_kind(term, Term, f"the term of {name!r} must be a fmuid.estimation.Term(values)")
