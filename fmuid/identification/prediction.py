"""Prediction: a result simulated over a record that it was not made from, and how well it meets what was measured.

Around the simulated output ŷ stands the band in which a new measurement is expected. Its variance is that of the noise
and that of the estimates carried through the sensitivities (the linear propagation behind (1.31)),

    s²(t) = σ² + j(t)ᵀ V j(t),   j = ∂ŷ/∂θ,   V the covariance of the estimates.

Where some values, such as initial states, are estimated again on the record itself, they follow the others: with S and
Z the whitened sensitivities of the record to the parameters kept and to the values estimated again, z and j those of
one output at one time,

    s² = σ² + mᵀ V m + zᵀ V_z z,   mᵀ = jᵀ − zᵀ Z⁺ S,   V_z the covariance of what is estimated again.

A model that carries over to the record has about as many measurements in the band as its level says, and residuals as
large as s. More than that is an error of the model that this record shows and the first one did not.

References
----------
L. Ljung, "System Identification: Theory for the User", 2nd ed., 1999, sections 16.5 and 16.6.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from scipy import special

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.codec import Layout
from fmuid.data import Experiment, Noise, Parameter
from fmuid.errors import NO_EXPERIMENT, InputError, check_kind
from fmuid.estimation import Result, check_level
from fmuid.formatting import nearest
from fmuid.identification.assessment import CONFIDENCE_LEVEL
from fmuid.identification.identify import identify
from fmuid.identification.problem import Problem, refinement_of
from fmuid.identification.residual_analysis import ResidualAnalysis
from fmuid.identification.residual_series import examine_outputs
from fmuid.models import FMU, System
from fmuid.simulation import OutputFit, Simulator, Value, column_conversion, fit_of, refined

# Sensitivities are differences over the parameters' standard deviations, but at most over this share of their
# magnitudes: what is wrong with them is a share of the band.
LARGEST_STEP = 1e-2


@dataclass(frozen=True)
class OutputScore:
    """How well one output is predicted, over the samples that count.

    Attributes
    ----------
    output : str
    unit : str
        "" without; of `rmse`, `mean` and `expected`.
    samples : int
    rmse : float
        Root mean square of measured − simulated.
    mean : float
        Mean of measured − simulated.
    fit : float
        Of `fmuid.simulation.nrmse_fit`, %: NaN where the measured output is constant.
    expected : float
        The root mean square that the noise of the first records and the covariance of the estimates let expect; NaN
        where that noise is not known.
    inside : float
        Share of the samples that lie in the band; NaN where there is none.
    """

    output: str
    unit: str
    samples: int
    rmse: float
    mean: float
    fit: float
    expected: float
    inside: float

    json_layout: ClassVar = Layout(derived=("ratio",))

    @property
    def ratio(self) -> float:
        """`rmse` over `expected`: about 1 for a model that carries over."""
        return self.rmse / self.expected if self.expected > 0 else math.nan


@dataclass(frozen=True, eq=False)
class Prediction:
    """A result simulated over one record.

    Attributes
    ----------
    fit : OutputFit
    std : (K, n_outputs) array
        Standard deviation of the simulated outputs by that of the estimates; NaN where the result leaves parameters
        undetermined.
    noise_std : (n_outputs,) array
        Of the noise; NaN of outputs that the result was not fitted to.
    half_width : (K, n_outputs) array
        Of the band around `fit.simulated`; NaN where there is none. Without `std` it is that of the noise alone.
    level : float
        Of the band.
    scores : tuple of OutputScore
        One an output that has samples that count.
    residuals : ResidualAnalysis
        Tests of measured − simulated.
    estimated : Result or None
        Of the values that were estimated again on this record.
    undetermined : tuple of str
        Parameters without a standard deviation, which leave the band without their part.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> prediction = fmuid.predict(coil.fmu, fmuid.identify(coil.problem()), coil.experiment)
    >>> round(prediction.scores[0].rmse, 3)
    0.009
    """

    fit: OutputFit
    std: Floats
    noise_std: Floats
    half_width: Floats
    level: float
    scores: tuple[OutputScore, ...]
    residuals: ResidualAnalysis
    estimated: Result | None
    undetermined: tuple[str, ...]

    json_layout: ClassVar = Layout(omitted={"std", "half_width"})

    @property
    def table(self) -> pd.DataFrame:
        """Time (s), and for each output ``measured.``, ``simulated.``, ``std.`` (by the estimates), and the band."""
        columns: dict[str, Floats] = {"time": self.fit.times}
        for j, output in enumerate(self.fit.outputs):
            simulated, half = self.fit.simulated[:, j], self.half_width[:, j]
            columns |= {
                f"measured.{output}": self.fit.measured[:, j],
                f"simulated.{output}": simulated,
                f"std.{output}": self.std[:, j],
                f"lower.{output}": simulated - half,
                f"upper.{output}": simulated + half,
            }
        return pd.DataFrame(columns)


@single_threaded
def predict(
    model: System | FMU | str | Path,
    result: Result,
    experiment: Experiment,
    *,
    values: Mapping[str, Value] | None = None,
    free: Mapping[str, Parameter] | None = None,
    step_size: float | None = None,
    level: float = CONFIDENCE_LEVEL,
) -> Prediction:
    """Simulate a result over a record, and set what was measured and the band in which it is expected beside it.

    Parameters
    ----------
    model : System, FMU or path
        What the result was made with.
    result : Result
        Also one that was read from a file.
    experiment : Experiment
        The record.
    values : mapping of str to float, int, bool or str, optional
        FMU variables held at a value; those that the result has an estimate of take that.
    free : mapping of str to Parameter, optional
        Values that are estimated again on this record, from it alone, such as initial states: all others are held.
    step_size : float, optional
        As for `Problem`.
    level : float
        Of the band.

    Raises
    ------
    InputError
        If record, model and result do not fit together, a parameter has one value for each experiment and none for
        this one, or the level is not between 0 and 1.
    SimulationError
        If the simulation fails.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> fmuid.predict(coil.fmu, fmuid.identify(coil.problem()), coil.experiment).fit.outputs
    ('i',)
    """
    check_level(level, "a band")
    check_kind(result, Result, "what is predicted with must be a fmuid.Result")
    check_kind(experiment, Experiment, NO_EXPERIMENT)
    free, values = free or {}, values or {}
    check_kind(free, Mapping, "free must be a mapping of names to fmuid.Parameter(start)")
    check_kind(values, Mapping, "values must be a mapping of variables to what they are held at")
    for name, parameter in free.items():
        check_kind(parameter, Parameter, f"{name!r} is free and must be a fmuid.Parameter(start)")
    system = System.of(model)
    free = {name: replace(each, prior=None, per_experiment=False) for name, each in free.items()}
    record = _Record(system, result, experiment, {**values, **result.chosen}, free, step_size)
    again = record.estimate() if free else None
    return record.predicted(again, level)


def estimates_for(result: Result, system: System, experiment: Experiment, without: Collection[str]) -> dict[str, str]:
    """Return which estimate each variable, but for some, takes in an experiment: variable to name of the parameter.

    Raises
    ------
    InputError
        If the model has no such variable, or a parameter per experiment none for this one (the result is of others).
    """
    found: dict[str, str] = {}
    here = ("", experiment.name) if result.made_from(experiment) else ("",)
    missing: dict[str, list[str]] = {}
    for name in result.names:
        variable, own = (name, "") if name in system.variables else _split(name)
        if variable not in system.variables:
            near = nearest(variable, system.variables)
            raise InputError(f"the result is of another model: {system.label} has no {variable!r}{near}")
        if variable in without:
            continue
        if own in here:
            found[variable] = name
        else:
            missing.setdefault(variable, []).append(own)
    for variable, others in missing.items():
        if variable not in found:
            raise InputError(
                f"the result has a value of {variable!r} for {', '.join(others)} and none for {experiment.name}: "
                f"have it estimated again on this record (--refit {variable})"
            )
    return found


def _split(name: str) -> tuple[str, str]:
    variable, bracket, experiment = name.rpartition("[")
    return (variable, experiment.removesuffix("]")) if bracket else (name, "")


class _Record:
    """One record and all that is known of it."""

    def __init__(
        self,
        system: System,
        result: Result,
        experiment: Experiment,
        values: dict[str, Value],
        free: dict[str, Parameter],
        step_size: float | None,
    ) -> None:
        self.system, self.result, self.experiment, self.free = system, result, experiment, free
        self.step_size = step_size
        known = estimates_for(result, system, experiment, free)
        self.names = tuple(known)  # of the variables that take an estimate
        self.at = [result.names.index(name) for name in known.values()]
        self.theta = result.values[self.at]
        self.held = {name: value for name, value in values.items() if name not in known and name not in free}
        self.finer = refinement_of(result)
        self.noise_std = np.array([self._noise_std(name) for name in experiment.output_names])

    def _noise_std(self, output: str) -> float:
        """Return the standard deviation of an output's noise in the unit of the record, NaN where it is not known."""
        first = next((series.unit for series in self.result.data if series.output == output), "")
        here = self.experiment.units.get(output, "")
        factors = [column_conversion(self.system, output, unit)[0] if unit else 1.0 for unit in (first, here)]
        return math.sqrt(self.result.variance.get(output, math.nan)) * abs(factors[0] / factors[1])

    def estimate(self) -> Result:
        """Estimate again what is free, all else being held."""
        names = self.experiment.output_names
        known = {name: std**2 for name, std in zip(names, self.noise_std.tolist(), strict=True) if std > 0}
        problem = Problem(
            self.system,
            self.experiment,
            self.free,
            noise=Noise(known) if known else None,
            values={**self.held, **dict(zip(self.names, self.theta.tolist(), strict=True))},
            step_size=self.step_size,
        )
        return identify(problem.finer(self.finer), accuracy="off", remedies=False)

    def predicted(self, again: Result | None, level: float) -> Prediction:
        """Simulate at the estimates, and what is asked of their scatter."""
        experiment = self.experiment
        simulator = Simulator(
            self.system, experiment, (*self.names, *self.free), values=self.held, step_size=self.step_size
        )
        simulator = refined(simulator, self.system, self.finer)
        point = self.theta if again is None else np.concatenate([self.theta, again.values])
        covariance = self.result.covariance[np.ix_(self.at, self.at)]
        own = np.zeros((0, 0)) if again is None else again.covariance
        scatter = np.sqrt(np.concatenate([np.diag(covariance), np.diag(own)]))
        names = (*self.names, *self.free)
        lost = tuple(names[i] for i in np.flatnonzero(~np.isfinite(scatter)))
        simulated, slopes = self._simulated(simulator, point, np.zeros_like(scatter) if lost else scatter)
        std = np.full(simulated.shape, np.nan) if lost else self._std(slopes, covariance, own)
        noise = np.broadcast_to(self.noise_std, std.shape)
        variance = noise**2 + np.where(np.isnan(std), 0.0, std) ** 2
        freedom = self.result.degrees_of_freedom
        tail = 0.5 + level / 2.0
        quantile = float(special.stdtrit(freedom, tail) if math.isfinite(freedom) else special.ndtri(tail))
        fit = fit_of(self.system, experiment, simulated)
        half = quantile * np.sqrt(variance)
        scores = tuple(
            _score(fit, j, variance[:, j], half[:, j]) for j in np.flatnonzero(fit.counted.any(axis=0)).tolist()
        )
        tests = ResidualAnalysis(tuple(examine_outputs(experiment, simulated)), {})
        return Prediction(fit, std, self.noise_std, half, level, scores, tests, again, lost)

    def _simulated(self, simulator: Simulator, point: Floats, scatter: Floats) -> tuple[Floats, Floats]:
        """Return the outputs (K, n_outputs) at a point (p,), and their slopes (K, n_outputs, p) where it scatters.

        Raises
        ------
        SimulationError
            If a simulation fails.
        """
        nominal = [parameter.nominal or abs(parameter.start) for parameter in self.free.values()]
        size = np.abs(point)
        size[len(self.names) :] = np.maximum(size[len(self.names) :], nominal)
        steps = np.minimum(scatter, LARGEST_STEP * np.where(size > 0, size, np.inf))
        moved = np.flatnonzero(steps > 0)
        points = np.tile(point, (1 + 2 * moved.size, 1))
        for row, i in enumerate(moved):
            points[1 + 2 * row, i] += steps[i]
            points[2 + 2 * row, i] -= steps[i]
        found = simulator.many(points)
        base, slopes = found.outputs[0], np.zeros((*found.outputs.shape[1:], point.size))
        for row, i in enumerate(moved):
            up, down = 1 + 2 * row, 2 + 2 * row
            if found.errors[up] is not None:  # beyond a bound of the model, perhaps
                slopes[:, :, i] = (base - found.outputs[down]) / steps[i]
            elif found.errors[down] is not None:
                slopes[:, :, i] = (found.outputs[up] - base) / steps[i]
            else:
                slopes[:, :, i] = (found.outputs[up] - found.outputs[down]) / (2.0 * steps[i])
        failed = [error for error in found.errors if error is not None]
        if found.errors[0] is not None or np.isnan(slopes).any():
            raise failed[0]
        return base, slopes

    def _std(self, slopes: Floats, covariance: Floats, own: Floats) -> Floats:
        """Return the standard deviations (K, n_outputs) of what is simulated."""
        kept = slopes[:, :, : len(self.names)]
        if not self.free:
            return np.asarray(np.sqrt(np.einsum("kjp,pq,kjq->kj", kept, covariance, kept)), dtype=np.float64)
        again = slopes[:, :, len(self.names) :]
        weights = np.where(np.isfinite(self.noise_std), 1.0 / self.noise_std, 0.0)
        counted = self.experiment.counted & (weights > 0)
        rows = np.broadcast_to(weights, counted.shape)[counted][:, None]
        inverse = np.linalg.pinv(again[counted] * rows)  # Z⁺
        left = kept - again @ (inverse @ (kept[counted] * rows))
        by_noise = np.einsum("kjp,pq,kjq->kj", again, own, again)
        by_estimates = np.einsum("kjp,pq,kjq->kj", left, covariance, left)
        return np.asarray(np.sqrt(by_noise + by_estimates), dtype=np.float64)


def _score(fit: OutputFit, j: int, variance: Floats, half: Floats) -> OutputScore:
    counted = fit.counted[:, j]
    error = (fit.measured - fit.simulated)[counted, j]
    known = bool(np.isfinite(half).all())
    return OutputScore(
        fit.outputs[j],
        fit.units[j] or "",
        int(counted.sum()),
        fit.rmse[j],
        float(error.mean()),
        fit.fit[j],
        math.sqrt(float(variance[counted].mean())) if known else math.nan,
        float((np.abs(error) <= half[counted]).mean()) if known else math.nan,
    )
