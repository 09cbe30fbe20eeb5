"""Prior, data and both: three estimates and their agreement.

The estimate is the mean of the prior and the optimum of the data alone, weighted by inverse covariances (1.55;
docs/method/noise-variances.md).
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
    Evaluator,
    LeastSquares,
    LinearizedProblem,
    Result,
    SensitivityError,
    State,
    TerminationReason,
    WeakDirection,
    WhitenedJacobian,
    local_covariance,
    sandwich_of,
)
from fmuid.formatting import nearest
from fmuid.identification.acquisition_delay import DelayedNoise
from fmuid.identification.conditional_optimum import PartialCost, cost_at, minimized
from fmuid.identification.prior_data_tests import PriorDataTest, VarianceTest, agree, known_variances, variance_tests
from fmuid.identification.residual_analysis import ResidualAnalysis, analyze_residuals


@dataclass(frozen=True)
class PriorDataSettings:
    """Limits above which the influence of a prior is named; reach of parabolas."""

    nonlinear_stds: float = 0.5  # distance of weighted mean and estimate that shows a nonlinear model
    least_move_stds: float = 1.0  # move of an estimate by the prior, ...
    resting_std_ratio: float = 2.0  # ... or factor of its σ without the prior
    reach_stds: float = 2.5  # of parabolas around the three optima
    points: int = 161  # of a parabola


SETTINGS = PriorDataSettings()
ESTIMATES = ("prior_std", "data", "data_std", "combined", "combined_std")
EFFECTS = ("pull", "moved", "moved_by", "conflict", "weighted_mean", "nonlinearity")


@dataclass(frozen=True)
class ExtrapolationReason:
    """Reason to extrapolate the optimum of the data alone.

    Attributes
    ----------
    robust : bool
        A robust loss, with which it is not searched.
    outcome : TerminationReason or None
        Of the search, where it did not converge.
    at_bounds : tuple of str
        Parameters that the data alone push to a bound.
    undetermined : tuple of WeakDirection
        Directions that the data alone do not identify.
    """

    robust: bool = False
    outcome: TerminationReason | None = None
    at_bounds: tuple[str, ...] = ()
    undetermined: tuple[WeakDirection, ...] = ()


@dataclass(frozen=True)
class PriorInfluence:
    """Influence of a prior on an estimate."""

    name: str
    prior: str  # the parameter whose prior acts most on it
    rests: bool  # True: the estimate rests on that prior, its σ is far larger without; False: the prior moved it


@dataclass(frozen=True, eq=False)
class PriorDataComparison:
    """Contributions of prior and data to a result.

    Attributes
    ----------
    names : tuple of str
    prior_mean, prior_std : (N,) arrays
        NaN without prior.
    data, data_std : (N,) arrays
        Optimum of the data alone; NaN and infinite where not identifiable.
    searched : bool
        `data` was found by a search, not extrapolated by one Gauss–Newton step.
    combined, combined_std : (N,) arrays
        The estimate.
    weighted_mean : (N,) array
        Of the prior and the data's optimum with its own paraboloid; NaN without a search.
    moves : (N, N) array
        Move of each estimate (rows) by the prior of each parameter (columns); NaN where the data do not identify it.
    agreement : PriorDataTest or None
        None where data and prior share no direction.
    variances : tuple of VarianceTest
        One an output of known variance, and one for all where there are several.
    obstacle : ExtrapolationReason or None
    """

    names: tuple[str, ...]
    prior_mean: Floats
    prior_std: Floats
    data: Floats
    data_std: Floats
    searched: bool
    combined: Floats
    combined_std: Floats
    weighted_mean: Floats
    moves: Floats
    agreement: PriorDataTest | None
    variances: tuple[VarianceTest, ...]
    obstacle: ExtrapolationReason | None

    json_layout: ClassVar = Layout(
        rows={"parameters": {name: name for name in ("prior_mean", *ESTIMATES, "weighted_mean", *EFFECTS)}}
    )

    @property
    def pull(self) -> Floats:
        """Distance of each estimate from its prior, in prior standard deviations (N,)."""
        return (self.combined - self.prior_mean) / self.prior_std

    @property
    def moved(self) -> Floats:
        """Move of each estimate by the prior, in σ (N,)."""
        return (self.combined - self.data) / self.combined_std

    @property
    def moved_by(self) -> tuple[str, ...]:
        """The parameter whose prior moved each estimate most, "" for none."""
        sizes = np.abs(np.nan_to_num(self.moves))
        return tuple(self.names[int(row.argmax())] if row.any() else "" for row in sizes)

    @property
    def conflict(self) -> Floats:
        """(θ_opt − θ₀)/√(M₀ + P_opt) of each parameter (N,)."""
        return (self.data - self.prior_mean) / np.hypot(self.prior_std, self.data_std)

    @property
    def nonlinearity(self) -> Floats:
        """Distance of the weighted mean from the estimate, in σ (N,)."""
        return (self.weighted_mean - self.combined) / self.combined_std

    @property
    def table(self) -> pd.DataFrame:
        """Prior, data-only and combined estimate side by side, one row a parameter."""
        columns = {"parameter": self.names, "prior": self.prior_mean}
        return pd.DataFrame(columns | {name: getattr(self, name) for name in (*ESTIMATES, *EFFECTS)})

    @property
    def influences(self) -> tuple[PriorInfluence, ...]:
        """Estimates that rest on a prior or were moved by one."""
        found = []
        for i in np.argsort(-np.abs(np.nan_to_num(self.moved)), kind="stable"):
            if self.moved_by[i] and math.isfinite(self.data_std[i]):
                rests = bool(self.data_std[i] >= SETTINGS.resting_std_ratio * self.combined_std[i])
                if rests or abs(self.moved[i]) >= SETTINGS.least_move_stds:
                    found.append(PriorInfluence(self.names[i], self.moved_by[i], rests))
        return tuple(found)

    @property
    def bent(self) -> str:
        """The parameter whose weighted mean shows a nonlinear model, "" for none."""
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
    """Compare prior, data and estimate.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of this problem.
    search_data : bool
        Search the optimum of the data alone, for about the cost of an identification; default: extrapolate it.
    healthy : mapping of str to float, optional
        Known noise variance of each output; default those given to the problem.
    diagnostics : ResidualAnalysis, optional
        Of the residuals, if already made.

    Raises
    ------
    InputError
        If the result was read from a file, or `healthy` has an unknown output or a variance that is not positive.
    SimulationError
        If the search is asked for and the simulation fails at the initial guess.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> known = {**coil.parameters, "R": fmuid.Parameter(3.0, min=0.0, prior=fmuid.Normal(4.2, 0.1))}
    >>> problem = fmuid.Problem(coil.fmu, coil.experiment, known)
    >>> reading = fmuid.compare_prior_and_data(problem, fmuid.identify(problem))
    >>> reading.pull.round(1)
    array([-2., nan])
    """
    local = result.fit.linearization
    if local is None or result.fit.noise is None:
        raise InputError("a result from a file lacks the residuals. Identify the study again.")
    known = known_variances(problem, result.fit.given_variance if healthy is None else healthy)
    examined = analyze_residuals(problem, result) if diagnostics is None else diagnostics
    variances = variance_tests(problem, result, known, local, examined)
    at, there, obstacle, noise = result.values, local, None, result.fit.noise
    if search_data and len(local.prior_residual) and local.data.rank == len(result.names):
        found = ExtrapolationReason(robust=True) if problem.loss is not None else _search_data(problem, result, local)
        if isinstance(found, ExtrapolationReason):
            obstacle = found
        else:
            at, there = found
            none = local.prior_jacobian[:0]
            own = replace(there, prior_residual=np.zeros(0), prior_jacobian=none, combined=there.data)
            noise = sandwich_of(problem, own, np.zeros(problem.counts.size, dtype=np.bool_)).noise
    searched = there is not local
    allowed = DelayedNoise.of(problem.as_in(result), result, noise)
    local, there = allowed.local(local), allowed.local(there)
    return PriorDataComparison(
        result.names,
        result.estimates.prior_mean,
        result.estimates.prior_std,
        at + there.data_step(),
        there.data_std(allowed.gram(there.data_basis)),
        searched,
        result.values,
        result.std,
        at + there.combine().step if searched else np.full(at.size, np.nan),
        local.moves(),
        agree(there, allowed),
        variances,
        obstacle,
    )


def parabolas(reading: pd.DataFrame, name: str) -> pd.DataFrame:
    """Compute the cost of prior, data and both (figure 1.1; 1.54, 1.57), from `PriorDataComparison.table`.

    Columns: ``value``, ``prior``, ``data``, ``both``; NaN without prior or identifying data. `InputError`: there is no
    such parameter, or its estimate has no standard deviation.
    """
    known = list(reading["parameter"])
    if name not in known:
        raise InputError(f"unknown parameter {name!r}{nearest(name, known)}. Choose {', '.join(known)}.")
    row = reading.iloc[known.index(name)]
    parts = {part: (float(row[part]), float(row[f"{part}_std"])) for part in ("prior", "data", "combined")}
    best, std = parts["combined"]
    if not (np.isfinite(best) and 0.0 < std < np.inf):
        raise InputError(f"the estimate of {name!r} has no σ for a parabola.")
    least = [mean for mean, spread in parts.values() if np.isfinite(mean) and 0.0 < spread < np.inf]
    grid = np.linspace(min(least) - SETTINGS.reach_stds * std, max(least) + SETTINGS.reach_stds * std, SETTINGS.points)
    found = {"value": grid}
    for part, (mean, spread) in parts.items():
        curve = ((grid - mean) / spread) ** 2 if spread < np.inf else np.full(SETTINGS.points, np.nan)
        found["both" if part == "combined" else part] = curve
    found["both"] += np.nan_to_num(float(row["conflict"])) ** 2
    return pd.DataFrame(found)


def parameters_with_prior_and_data(reading: pd.DataFrame) -> list[str]:
    """Return the parameters with a prior that the data identify, too."""
    finite = np.isfinite(reading[["prior_std", "data_std", "combined_std"]].to_numpy(np.float64)).all(axis=1)
    return [str(name) for name in reading["parameter"][finite]]


def _search_data(
    problem: LeastSquares, result: Result, local: LinearizedProblem
) -> tuple[Floats, LinearizedProblem] | ExtrapolationReason:
    """Return the optimum of the data alone, or the reason for none."""
    state = State(result.values.copy(), local.residual, local.jacobian, fresh=False)
    try:
        function = cost_at(Evaluator(problem.as_in(result)), result)
        alone = PartialCost(function, state.theta, slice(None), problem.measured.size)
        state = minimized(alone, state)
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
    data = local_covariance(result.names, WhitenedJacobian(state.jacobian, error), magnitudes, theta=state.theta)
    if data.rank < len(result.names):
        return ExtrapolationReason(undetermined=data.undetermined)
    prior = problem.parameters.prior_residual(state.theta[None])[0]
    there = LinearizedProblem(
        state.residual, state.jacobian, prior, local.prior_jacobian, local.levels, magnitudes, data, local.combined
    )
    return state.theta, there
