"""Reading a result: prior, data and their combination side by side, and whether they agree (docs/method.md section 7).

The estimate θ_C is the barycentre of the prior θ₀ and the optimum of the data alone θ_opt, each weighed by its inverse
covariance (1.55): the prior is an elastic return force. Shown are all three with their standard deviations, how far
the prior has moved each estimate and whose prior it was. A wrong prior biases irremediably:
`fmuid.identification.prior_data_tests` tests whether the data contradict it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.errors import InputError
from fmuid.estimation import (
    CostFunction,
    Descent,
    Evaluator,
    LeastSquares,
    LinearizedProblem,
    Marquardt,
    Result,
    SensitivityError,
    State,
    TerminationReason,
    WeakDirection,
    last_state,
    local_covariance,
    prepare,
    sandwich_of,
)
from fmuid.identification.prior_data_tests import PriorDataTest, VarianceTest, agree, known_variances, variance_tests
from fmuid.identification.residual_analysis import ResidualAnalysis, analyze_residuals


@dataclass(frozen=True)
class InfluenceLimits:
    """What is worth naming of a prior."""

    nonlinear_stds: float = 0.5
    """A barycentre further than this from the estimate shows that the model is not linear."""
    least_move_stds: float = 1.0
    """An estimate is named that the prior moved by more than this, in standard deviations, ..."""
    resting_std_ratio: float = 2.0
    """... or whose standard deviation would be larger by this factor without the prior."""


SETTINGS = InfluenceLimits()


@dataclass(frozen=True)
class ExtrapolationReason:
    """Why the optimum of the data alone is extrapolated although it was to be searched.

    Attributes
    ----------
    robust : bool
        A robust loss, with which it is not searched.
    outcome : TerminationReason or None
        How its search ended, where it did not converge.
    at_bounds : tuple of str
        The parameters that the data alone push to a bound.
    undetermined : tuple of WeakDirection
        What the data alone leave open there.
    """

    robust: bool = False
    outcome: TerminationReason | None = None
    at_bounds: tuple[str, ...] = ()
    undetermined: tuple[WeakDirection, ...] = ()


@dataclass(frozen=True)
class PriorInfluence:
    """What a prior does to an estimate.

    Attributes
    ----------
    name : str
        The parameter.
    prior : str
        The parameter whose prior did most of it.
    rests : bool
        Whether the estimate rests on that prior, its standard deviation being far larger without; else it was moved.
    """

    name: str
    prior: str
    rests: bool


@dataclass(frozen=True, eq=False)
class PriorDataComparison:
    """What prior and data contribute to a result, and whether they agree.

    Attributes
    ----------
    names : tuple of str
    prior_mean, prior_std : (N,) arrays
        NaN where there is no prior.
    data, data_std : (N,) arrays
        The optimum of the data alone; NaN and infinite where they do not determine a parameter.
    searched : bool
        Whether `data` was found by a search, and not extrapolated from the estimate by one Gauss–Newton step.
    combined, combined_std : (N,) arrays
        The estimate.
    barycentre : (N,) array
        Of the prior and the data's optimum with its own paraboloid; NaN without a search.
    moves : (N, N) array
        How far the prior of each parameter (columns) moved each estimate (rows) from the data's optimum, by the
        paraboloids at the estimate; NaN where the data do not determine a parameter.
    agreement : PriorDataTest or None
        None where data and prior have nothing in common.
    variances : tuple of VarianceTest
        One an output whose variance is known, and one for all of them where there are several.
    obstacle : ExtrapolationReason or None
        What stood in the way of the search for the data's optimum.
    """

    names: tuple[str, ...]
    prior_mean: Floats
    prior_std: Floats
    data: Floats
    data_std: Floats
    searched: bool
    combined: Floats
    combined_std: Floats
    barycentre: Floats
    moves: Floats
    agreement: PriorDataTest | None
    variances: tuple[VarianceTest, ...]
    obstacle: ExtrapolationReason | None

    json_layout: ClassVar = Layout(
        rows={
            "parameters": {
                **{"prior_mean": "prior_mean", "prior_std": "prior_std", "data": "data", "data_std": "data_std"},
                **{"combined": "combined", "combined_std": "combined_std", "barycentre": "barycentre", "pull": "pull"},
                **{"moved": "moved", "moved_by": "moved_by", "conflict": "conflict", "nonlinearity": "nonlinearity"},
            }
        }
    )

    @property
    def pull(self) -> Floats:
        """How far each estimate lies from its prior, in prior standard deviations (N,)."""
        return (self.combined - self.prior_mean) / self.prior_std

    @property
    def moved(self) -> Floats:
        """How far the prior moved each estimate from the data's optimum, in the estimate's standard deviations (N,)."""
        return (self.combined - self.data) / self.combined_std

    @property
    def moved_by(self) -> tuple[str, ...]:
        """The parameter whose prior moved each estimate most, "" where none did."""
        sizes = np.abs(np.nan_to_num(self.moves))
        return tuple(self.names[int(row.argmax())] if row.any() else "" for row in sizes)

    @property
    def conflict(self) -> Floats:
        """(θ_opt − θ₀)/√(M₀ + P_opt) of each parameter by itself (N,)."""
        return (self.data - self.prior_mean) / np.hypot(self.prior_std, self.data_std)

    @property
    def nonlinearity(self) -> Floats:
        """How far the barycentre lies from the estimate, in standard deviations of the estimate (N,)."""
        return (self.barycentre - self.combined) / self.combined_std

    @property
    def table(self) -> pd.DataFrame:
        """Prior, data-only and combined estimate side by side, one row a parameter."""
        return pd.DataFrame(
            {
                "parameter": list(self.names),
                "prior": self.prior_mean,
                "prior_std": self.prior_std,
                "data": self.data,
                "data_std": self.data_std,
                "combined": self.combined,
                "combined_std": self.combined_std,
                "pull": self.pull,
                "moved": self.moved,
                "moved_by": list(self.moved_by),
                "conflict": self.conflict,
                "barycentre": self.barycentre,
                "nonlinearity": self.nonlinearity,
            }
        )

    @property
    def influences(self) -> tuple[PriorInfluence, ...]:
        """The estimates that rest on a prior, and others that a prior has moved, the most first."""
        found = []
        for i in np.argsort(-np.abs(np.nan_to_num(self.moved)), kind="stable"):
            if self.moved_by[i] and math.isfinite(self.data_std[i]):
                rests = bool(self.data_std[i] >= SETTINGS.resting_std_ratio * self.combined_std[i])
                if rests or abs(self.moved[i]) >= SETTINGS.least_move_stds:
                    found.append(PriorInfluence(self.names[i], self.moved_by[i], rests))
        return tuple(found)

    @property
    def bent(self) -> str:
        """The parameter whose barycentre lies so far from the estimate that the model is not linear, "" for none."""
        off = np.abs(np.nan_to_num(self.nonlinearity))
        i = int(np.argmax(off))
        return self.names[i] if off[i] >= SETTINGS.nonlinear_stds else ""


@single_threaded
def compare_prior_and_data(
    problem: LeastSquares,
    result: Result,
    *,
    search_data: bool = False,
    healthy: Mapping[str, float] | None = None,
    diagnostics: ResidualAnalysis | None = None,
) -> PriorDataComparison:
    """Read a result.

    Parameters
    ----------
    problem : LeastSquares
        That the result was found for.
    result : Result
        As `fmuid.identify` returns it.
    search_data : bool
        Whether to search the optimum of the data alone, which costs about as much as the identification itself.
        Otherwise it is where the paraboloid at the estimate has it, and nothing is simulated.
    healthy : mapping of str to float, optional
        Known noise variance of each output, of the healthy system; default those given to the problem.
    diagnostics : ResidualAnalysis, optional
        Of the residuals, where they have already been examined.

    Raises
    ------
    InputError
        If the result was read from a file, or `healthy` names no measured output or a variance that is not positive.
    SimulationError
        If the search is asked for and the simulation fails where the identification began.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> known = {**coil.parameters, "R": fmuid.Parameter(3.0, min=0.0, prior=fmuid.Normal(4.2, 0.1))}
    >>> problem = fmuid.Problem(coil.fmu, coil.experiment, known)
    >>> reading = fmuid.compare_prior_and_data(problem, fmuid.identify(problem))
    >>> reading.pull.round(1)
    array([-2., nan])
    """
    local = result.local
    if local is None or result.noise is None:
        raise InputError("a result read from a file cannot be read in this way; identify the study again")
    known = known_variances(problem, result.given_variance if healthy is None else healthy)
    examined = analyze_residuals(problem, result) if diagnostics is None else diagnostics
    variances = variance_tests(problem, result, known, local, examined)
    at, there, obstacle, noise = result.values, local, None, result.noise
    if search_data and len(local.prior_residual) and local.data.rank == len(result.names):
        found = ExtrapolationReason(robust=True) if problem.loss is not None else _search_data(problem, result, local)
        if isinstance(found, ExtrapolationReason):
            obstacle = found
        else:
            at, there = found
            own = replace(
                there, prior_residual=np.zeros(0), prior_jacobian=local.prior_jacobian[:0], combined=there.data
            )
            noise = sandwich_of(problem, own, np.zeros(problem.counts.size, dtype=np.bool_)).noise
    searched = there is not local
    data_std = there.data_std(noise.gram(there.data_basis))
    white = there.combine()
    return PriorDataComparison(
        result.names,
        result.prior_mean,
        result.prior_std,
        at + there.data_step(),
        data_std,
        searched,
        result.values,
        result.std,
        at + white.step if searched else np.full(at.size, np.nan),
        local.moves(),
        agree(there, noise),
        variances,
        obstacle,
    )


# --- the optimum of the data alone ------------------------------------------------------


class _DataAlone:
    """A criterion without the rows of the prior; a `ResidualFunction`."""

    def __init__(self, criterion: CostFunction) -> None:
        self._criterion, self._rows = criterion, criterion.problem.measured.size
        self.lower, self.upper, self.noise = criterion.lower, criterion.upper, criterion.noise

    def magnitudes(self, theta: Floats) -> Floats:
        """Return how large each parameter is (N,)."""
        return self._criterion.magnitudes(theta)

    def residuals(self, thetas: Floats) -> Floats:
        """Return (m, n) for thetas (m, N), NaN rows where failed."""
        return self._criterion.residuals(thetas)[:, : self._rows]

    def jacobian(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the derivative (n, N)."""
        return self._criterion.jacobian(theta, residual, central=central)[: self._rows]

    def measure_noise(self, theta: Floats, residual: Floats, steps: Floats) -> tuple[float, bool]:
        """Measure the simulation's noise anew."""
        found = self._criterion.measure_noise(theta, residual, steps)
        self.noise = self._criterion.noise
        return found

    def jacobian_error(self, theta: Floats, residual: Floats, *, central: bool) -> Floats:
        """Return the norm of the error in each of its columns (N,)."""
        return self._criterion.jacobian_error(theta, residual, central=central)


def _search_data(
    problem: LeastSquares, result: Result, local: LinearizedProblem
) -> tuple[Floats, LinearizedProblem] | ExtrapolationReason:
    """Return the optimum of the data alone and the local model there, or why there is none."""
    variance = np.array([result.variance[name] for name in problem.output_names])
    state = State(result.values.copy(), local.residual, local.jacobian, fresh=False)
    try:
        alone = _DataAlone(prepare(Evaluator(problem.as_in(result)), result.start).criterion.reweighted(variance))
        state = last_state(Descent(Marquardt()), alone, state)
        if not state.fresh:
            state = replace(state, jacobian=alone.jacobian(state.theta, state.residual, central=True))
    except SensitivityError:
        state = replace(state, outcome=TerminationReason.FAILING)
    except KeyboardInterrupt:
        state = replace(state, outcome=TerminationReason.INTERRUPTED)
    if state.outcome is None or not state.outcome.converged:
        return ExtrapolationReason(outcome=state.outcome)
    held = [result.names[i] for i in np.flatnonzero(state.held)]
    if held:
        return ExtrapolationReason(at_bounds=tuple(held))
    magnitudes = alone.magnitudes(state.theta)
    error = alone.jacobian_error(state.theta, state.residual, central=state.central)
    data = local_covariance(result.names, state.jacobian, magnitudes, error, theta=state.theta)
    if data.rank < len(result.names):
        return ExtrapolationReason(undetermined=data.undetermined)
    prior = problem.parameters.prior_residual(state.theta[None])[0]
    there = LinearizedProblem(
        state.residual, state.jacobian, prior, local.prior_jacobian, magnitudes, data, local.combined
    )
    return state.theta, there
