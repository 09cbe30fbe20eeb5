"""Differential equations that are linear in their parameters, estimated from records without a simulation.

D^p0 s_0 = Σ θ_j D^pj s_j, with measured signals s, holds for the signals as a state-variable filter sees them too
(`fmuid.estimation.linear_models.filters`): regressors for least squares. Where a measured output is among them, its
noise is too, and biases the estimates. Instruments, the same regressors made of a simulated output, have nothing to do
with that noise.

References
----------
P. C. Young, "Some observations on instrumental variable methods of time-series analysis", Int. J. Control 23 (5), 1976.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, numbers
from fmuid.blas import single_threaded
from fmuid.errors import InputError, check_kind
from fmuid.estimation.linear_models.estimate import Estimator, LinearEstimate, solve
from fmuid.estimation.linear_models.filters import StateVariableFilter, Term
from fmuid.formatting import nearest

# Instruments have settled where the estimates move by less than this share of their standard deviations,
SETTLED = 1e-3
# or, without noise, of themselves.
ROUNDING = 1e-9
MOST_ROUNDS = 20


@single_threaded
def equation_error(
    times: ArrayLike, target: Term, terms: Mapping[str, Term], *, cutoff: float, order: int | None = None
) -> LinearEstimate:
    """Estimate the parameters of D^p0 s_0 = Σ θ_j D^pj s_j by least squares of the filtered equation.

    A start for `identify`, found without a simulation, and no result: noise in the terms biases it, the more the faster
    the filter, however long the record (`instrumental_variables` is free of that).

    Parameters
    ----------
    times : (K,) array
        Increasing, of any distances, s.
    target : Term
        What stands alone on one side, such as the voltage in R i + L di/dt = u.
    terms : mapping of str to Term
        What stands behind each parameter.
    cutoff : float
        λ of the filter (λ/(s + λ))^order, rad/s: near the inverse of the time constant that matters most.
    order : int, optional
        Default: the highest derivative and one more.

    Returns
    -------
    LinearEstimate

    Raises
    ------
    InputError
        If the terms do not fit the times or the filter, or depend on each other in the record.

    Examples
    --------
    A coil of 4 Ω and 0.1 H from rest at 1 V:

    >>> import numpy as np, fmuid
    >>> t = np.arange(0.0, 0.2, 1e-3)
    >>> i = (1.0 - np.exp(-t / 0.025)) / 4.0
    >>> terms = {"R": fmuid.Term(i), "L": fmuid.Term(i, derivative=1)}
    >>> voltage = fmuid.Term(np.ones_like(t), interpolation="zoh")
    >>> fmuid.equation_error(t, voltage, terms, cutoff=40.0).values.round(3)
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
    """Estimate the parameters of D^p0 s_0 = Σ θ_j D^pj s_j with a simulation's terms as instruments.

    Parameters
    ----------
    times, target, terms, cutoff, order
        As for `equation_error`.
    simulated : callable
        Theta (N,), in the order of the terms, to the terms with simulated signals in the place of measured outputs. The
        simulation must be of the inputs alone.
    start : (N,) array, optional
        What is simulated first; default: what `equation_error` gives.

    Returns
    -------
    LinearEstimate
        Simulated anew until the estimates settle, 20 times at most: `LinearEstimate.converged` says whether they have.

    Raises
    ------
    InputError
        As `equation_error`, and if the simulated terms are not those of the parameters or not finite.

    Examples
    --------
    >>> times = np.linspace(0.0, 5.0, 501)
    >>> u = np.sign(np.sin(3.0 * times))
    >>> def simulated(theta):
    ...     y = np.zeros(times.size)
    ...     for k in range(times.size - 1):
    ...         y[k + 1] = y[k] + 0.01 * (theta[0] * y[k] + theta[1] * u[k])
    ...     return {"a": fmuid.Term(y), "b": fmuid.Term(u, interpolation="zoh")}
    >>> y = simulated([-2.0, 4.0])["a"].values + 0.05 * np.random.default_rng(0).standard_normal(times.size)
    >>> terms = {"a": fmuid.Term(y), "b": fmuid.Term(u, interpolation="zoh")}
    >>> fmuid.instrumental_variables(times, fmuid.Term(y, derivative=1), terms, simulated, cutoff=10.0).values.round(1)
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
    while not settled and rounds < MOST_ROUNDS:
        instruments = equation.made_of(simulated(theta.copy()), theta)
        found = solve(kind, equation.names, equation.rows, equation.values, instruments)
        settled = bool((np.abs(found.values - theta) <= SETTLED * found.std + ROUNDING * np.abs(theta)).all())
        theta, rounds = found.values, rounds + 1
    return replace(found, rounds=rounds, converged=settled)


class _Equation:
    """A filtered equation: its regressors with the free terms of the start, and its target."""

    def __init__(
        self, times: ArrayLike, target: Term, terms: Mapping[str, Term], cutoff: float, order: int | None
    ) -> None:
        _check_terms(terms, "terms")
        check_kind(target, Term, "target must be a fmuid.Term(values)")
        if not terms:
            raise InputError("terms are missing: name each parameter with the term that stands behind it")
        highest = max(term.derivative for term in (target, *terms.values()))
        self.filter = StateVariableFilter(times, cutoff, highest + 1 if order is None else order)
        self.names = tuple(terms)
        self.free = self.filter.start_terms()
        columns = self.filter.columns([*terms.values(), target])
        self.rows, self.values = np.column_stack([columns[:, :-1], self.free]), columns[:, -1]

    def made_of(self, terms: Mapping[str, Term], theta: Floats) -> Floats:
        """Return the regressors (K, N + free) of other terms, simulated at theta (N,)."""
        _check_terms(terms, "what simulated returns")
        for name in self.names:
            if name not in terms:
                raise InputError(f"the simulated terms have none for {name!r}{nearest(name, terms)}")
            if not np.isfinite(numbers(terms[name].values, f"the simulated term of {name!r}")).all():
                values = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.names, theta.tolist(), strict=True))
                raise InputError(f"the simulated term of {name!r} is not finite with {values}: give another start")
        return np.column_stack([self.filter.columns([terms[name] for name in self.names]), self.free])


def _check_terms(terms: Mapping[str, Term], what: str) -> None:
    check_kind(terms, Mapping, f"{what} must be a mapping of parameters to fmuid.Term(values)")
    for name, term in terms.items():
        check_kind(term, Term, f"the term of {name!r} must be a fmuid.Term(values)")
