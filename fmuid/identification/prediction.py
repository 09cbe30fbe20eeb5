"""Prediction of validation data with the band in which measurements are expected.

    s²(t) = σ² + j(t)ᵀ V j(t),   j = ∂ŷ/∂θ,   V the covariance of the estimates (1.31).

Values refitted on the recording follow the others: with S and Z the whitened sensitivities to kept and refitted values,

    s² = σ² + mᵀ V m + zᵀ V_z z,   mᵀ = jᵀ − zᵀ Z⁺ S,   V_z the covariance of refitted values.

Model errors that the result has freed are added, with their directions over this recording; their sizes count as
estimates. Values are refitted without them.
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
from fmuid.data import Experiment, Noise, Parameter, is_quantity, usual_step
from fmuid.errors import NO_EXPERIMENT, InputError, check_kind
from fmuid.estimation import Result, check_level
from fmuid.formatting import nearest
from fmuid.identification.assessment import CONFIDENCE_LEVEL
from fmuid.identification.identify import identify
from fmuid.identification.likelihood_scaling import quantile
from fmuid.identification.model_errors import OF_RECORD, ModelError, ModelErrors
from fmuid.identification.problem import ModelReference, Problem, refinement_of
from fmuid.identification.residual_analysis import ResidualAnalysis
from fmuid.identification.residual_series import examine_outputs
from fmuid.models import FMU, System
from fmuid.simulation import AnySimulator, OutputFit, Value, finer_simulator, fit_of, output_factor, simulator_of

LARGEST_STEP = 1e-2  # of differences, relative to the magnitude; smaller σ are the step


@dataclass(frozen=True)
class PredictionSettings:
    """Limits of a prediction that is as expected."""

    ratio: float = 1.25  # RMS error in σ: more is an error of the model ...
    level: float = 0.01  # ... unless chance brings it in so few samples


SETTINGS = PredictionSettings()


@dataclass(frozen=True)
class OutputScore:
    """Quality of the prediction of one output, over the counted samples.

    Attributes
    ----------
    output, unit : str
        "" without unit; the unit is of `rmse`, `mean` and `expected`.
    samples : int
    rmse, mean : float
        Of measured − simulated.
    fit : float
        NRMSE fit, %; NaN where the measured output is constant.
    expected : float
        RMSE expected from noise and covariance; NaN where the noise is unknown.
    ratio : float
        RMS of the errors in their expected σ, about 1 for a valid model; NaN where the noise is unknown.
    inside : float
        Share of the samples in the band; NaN without band.
    """

    output: str
    unit: str
    samples: int
    rmse: float
    mean: float
    fit: float
    expected: float
    ratio: float
    inside: float

    json_layout: ClassVar = Layout(derived=("is_worse",))

    @property
    def is_worse(self) -> bool:
        """True if the errors are larger than expected."""
        by_chance = float(special.chdtri(self.samples, SETTINGS.level)) / self.samples
        return self.ratio > math.sqrt(max(SETTINGS.ratio**2, by_chance))


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of one recording.

    Attributes
    ----------
    fit : OutputFit
    std : (K, n_outputs) array
        σ of the simulated outputs by the estimates; NaN where the result has no covariance.
    noise_std : (n_outputs,) array
        NaN of outputs that the result was not fitted to.
    half_width : (K, n_outputs) array
        Of the band; of the noise alone without `std`, NaN without both.
    level : float
        Confidence level of the band.
    scores : tuple of OutputScore
        One an output with counted samples.
    residuals : ResidualAnalysis
    estimated : Result or None
        Of the refitted values.
    undetermined : tuple of str
        Parameters without σ, which the band leaves out.
    errors : tuple of ModelError
        Freed errors that the simulated outputs have.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> prediction = fmuid.predict(fmuid.identify(coil.problem()), coil.experiment)
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
    errors: tuple[ModelError, ...] = ()

    json_layout: ClassVar = Layout(omitted={"std", "half_width"})

    @property
    def table(self) -> pd.DataFrame:
        """Time (s), or row and inputs, or frequency; measured, simulated, std, lower and upper of each output."""
        columns = dict(self.fit.axis) or {"time": self.fit.times}
        for j, output in enumerate(self.fit.outputs):
            simulated, half = self.fit.simulated[:, j], self.half_width[:, j]
            columns |= {
                f"measured.{output}": self.fit.measured[:, j],
                f"simulated.{output}": simulated,
                f"std.{output}": self.std[:, j],
                f"lower.{output}": simulated - half,
                f"upper.{output}": simulated + half,
            }
        return pd.DataFrame(columns | self.fit.input_columns)


@single_threaded
def predict_by_model(
    model: ModelReference | System | FMU | str | Path,
    result: Result,
    experiment: Experiment,
    *,
    free: Mapping[str, Parameter] | None = None,
    level: float = CONFIDENCE_LEVEL,
    errors: ModelErrors | None = None,
) -> Prediction:
    """Predict an experiment by a result and a model; arguments and exceptions as of `fmuid.predict`.

    A reference to a model has fixed values and a step size, too. Estimates come before fixed values. Values that are
    `free`, such as initial states, are refitted on this experiment alone. Freed `errors` are added.
    """
    check_level(level, "a band")
    check_kind(result, Result, "what is predicted with must be a fmuid.Result")
    check_kind(experiment, Experiment, NO_EXPERIMENT)
    free = free or {}
    check_kind(free, Mapping, "free must be a mapping of names to fmuid.Parameter(start)")
    for name, parameter in free.items():
        check_kind(parameter, Parameter, f"{name!r} is free and must be a fmuid.Parameter(start)")
    known = model if isinstance(model, ModelReference) else ModelReference(System.of(model), {})
    free = {name: replace(each, prior=None, per_experiment=False) for name, each in free.items()}
    record = _Record(known, result, experiment, {**known.values, **result.chosen}, free)
    return record.predicted(record.estimate() if free else None, level, None if free else errors)


def estimates_for(result: Result, system: System, experiment: Experiment, without: Collection[str]) -> dict[str, str]:
    """Return the parameter of each variable with an estimate in an experiment.

    `InputError`: the model has no such variable, or a parameter per experiment has no value for this one.
    """
    found: dict[str, str] = {}
    here = ("", experiment.name) if result.made_from(experiment) else ("",)
    missing: dict[str, list[str]] = {}
    for name in result.names:
        variable, own = name, ""
        if name not in system.variables and "[" in name:
            variable, _, own = name.removesuffix("]").rpartition("[")
        if variable not in system.variables and is_quantity(variable):
            if experiment.observation is None or variable not in experiment.observation.names:
                continue  # a sensor that this experiment lacks
        elif variable not in system.variables:
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
                f"the result has {variable!r} for {', '.join(others)} but not for {experiment.name}. "
                f"Estimate it from these data: --refit {variable}."
            )
    return found


class _Record:
    """One recording with its estimates, fixed values and noise."""

    def __init__(
        self,
        model: ModelReference,
        result: Result,
        experiment: Experiment,
        values: dict[str, Value],
        free: dict[str, Parameter],
    ) -> None:
        self.system, self.step_size = model.system, model.step_size
        self.result, self.experiment, self.free = result, experiment, free
        known = estimates_for(result, model.system, experiment, free)
        self.names = tuple(known)  # of the variables that take an estimate
        self.at = [result.names.index(name) for name in known.values()]
        self.theta = result.values[self.at]
        self.held = {name: value for name, value in values.items() if name not in known and name not in free}
        self.finer = refinement_of(result)
        self.noise_std = np.array([self._noise_std(name) for name in experiment.output_names])

    def _noise_std(self, output: str) -> float:
        """Return the noise level in the recording's unit, NaN if unknown."""
        first = next((series.unit for series in self.result.setup.data if series.output == output), "")
        here = self.experiment.units.get(output, "")
        factors = [output_factor(self.system, output, unit) if unit else 1.0 for unit in (first, here)]
        return math.sqrt(self.result.fit.variance.get(output, math.nan)) * abs(factors[0] / factors[1])

    def estimate(self) -> Result:
        """Identify the free values."""
        pairs = zip(self.experiment.output_names, self.noise_std.tolist(), strict=True)
        known = {name: std**2 for name, std in pairs if std > 0}
        problem = Problem(
            self.system,
            self.experiment,
            self.free,
            noise=Noise(known) if known else None,
            values={**self.held, **dict(zip(self.names, self.theta.tolist(), strict=True))},
            step_size=self.step_size,
        )
        return identify(problem.finer(self.finer), solver_check="off", restart=False)

    def predicted(self, again: Result | None, level: float, errors: ModelErrors | None) -> Prediction:
        experiment, names = self.experiment, (*self.names, *self.free)
        simulator = simulator_of(self.system, experiment, names, self.held, self.step_size)
        simulator = finer_simulator(simulator, self.system, self.finer)
        point = self.theta if again is None else np.concatenate([self.theta, again.values])
        covariance = self.result.covariance[np.ix_(self.at, self.at)]
        own = np.zeros((0, 0)) if again is None else again.covariance
        scatter = np.sqrt(np.concatenate([np.diag(covariance), np.diag(own)]))
        lost = tuple(names[i] for i in np.flatnonzero(~np.isfinite(scatter)))
        steps = self._steps(point, np.zeros_like(scatter) if lost else scatter)
        simulated, slopes = _slopes(simulator, point, steps)
        added = _Added.of(errors, simulator, point, simulated, slopes) if errors is not None and errors.freed else None
        if added is not None:
            simulated = simulated + added.columns @ added.sizes
            slopes = np.concatenate([slopes, added.columns], axis=2)
            beside = added.covariance[:, self.at]
            covariance = np.block([[covariance, beside.T], [beside, added.covariance[:, len(self.result.names) :]]])
        std = np.full(simulated.shape, np.nan) if lost else self._std(slopes, covariance, own)
        variance = self._noise_levels**2 + np.where(np.isnan(std), 0.0, std) ** 2
        fit = fit_of(self.system, experiment, simulated)
        half = quantile(self.result.fit.degrees_of_freedom, level) * np.sqrt(variance)
        scores = tuple(
            _score(fit, j, variance[:, j], half[:, j]) for j in np.flatnonzero(fit.counted.any(axis=0)).tolist()
        )
        tests = ResidualAnalysis(tuple(examine_outputs(experiment, simulated)), {})
        carried = () if added is None else added.errors
        return Prediction(fit, std, self.noise_std, half, level, scores, tests, again, lost, carried)

    @property
    def _noise_levels(self) -> Floats:
        """Noise level of each sample (K, n_outputs): of a response the fraction of its magnitude that the fit had."""
        levels = np.tile(self.noise_std, (len(self.experiment.times), 1))
        for j, name in enumerate(self.experiment.output_names if self.experiment.kind == "frequency" else ()):
            own = [each for each in self.result.setup.data if each.output == name]
            squares = sum(each.samples * each.reading**2 for each in own)
            if squares:
                relative = self.result.fit.variance[name] * sum(each.samples for each in own) / squares
                levels[:, j] = math.sqrt(relative) * self.experiment.readings(name)
        return levels

    def _steps(self, point: Floats, scatter: Floats) -> Floats:
        """Return the steps of differences (p,)."""
        nominal = [parameter.nominal or abs(parameter.start) for parameter in self.free.values()]
        size = np.abs(point)
        size[len(self.names) :] = np.maximum(size[len(self.names) :], nominal)
        return np.minimum(scatter, LARGEST_STEP * np.where(size > 0, size, np.inf))

    def _std(self, slopes: Floats, covariance: Floats, own: Floats) -> Floats:
        """Return the standard deviations (K, n_outputs) of the simulated outputs."""
        kept, again = np.split(slopes, [len(covariance)], axis=2)
        weights = np.divide(1.0, self.noise_std, out=np.zeros_like(self.noise_std), where=self.noise_std > 0)
        counted = self.experiment.counted & (weights > 0)
        rows = np.broadcast_to(weights, counted.shape)[counted][:, None]
        inverse = np.linalg.pinv(again[counted] * rows)  # Z⁺
        left = kept - again @ (inverse @ (kept[counted] * rows))
        parts = [np.einsum("kjp,pq,kjq->kj", *each) for each in ((again, own, again), (left, covariance, left))]
        return np.asarray(np.sqrt(parts[0] + parts[1]), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Added:
    """Freed errors in a prediction."""

    errors: tuple[ModelError, ...]
    sizes: Floats  # (m,)
    columns: Floats  # (K, n_outputs, m)
    covariance: Floats  # (m, N + m), with the estimates and with each other

    @classmethod
    def of(
        cls, errors: ModelErrors, simulator: AnySimulator, theta: Floats, simulated: Floats, slopes: Floats
    ) -> _Added | None:
        """Return the errors of the plant; those of one record, and alternatives of unsure size, are left out."""
        from fmuid.identification.directions import changes_by

        samples = errors.interval / (usual_step(simulator.experiment.times) or math.nan)
        found = {each.test.direction.key: each for each in errors.freed if not each.kinds & OF_RECORD}
        factors = {key: samples if each.test.direction.unit == "samples" else 1.0 for key, each in found.items()}
        sizes = {key: factors[key] * each.test.size for key, each in found.items() if math.isfinite(factors[key])}
        columns = changes_by(sizes, simulator, theta, simulated, np.moveaxis(slopes, 2, 0)) if sizes else {}
        if not columns:
            return None
        at = [k for k, each in enumerate(errors.freed) if each.test.direction.key in columns]
        kept, count = [errors.freed[k] for k in at], errors.covariance.shape[1] - len(errors.freed)
        scaled = [factors[each.test.direction.key] * columns[each.test.direction.key] for each in kept]
        covariance = errors.covariance[np.ix_(at, [*range(count), *(count + k for k in at)])]
        return cls(tuple(kept), np.array([each.test.size for each in kept]), np.stack(scaled, axis=2), covariance)


def _slopes(simulator: AnySimulator, point: Floats, steps: Floats) -> tuple[Floats, Floats]:
    """Return outputs (K, n) and their slopes (K, n, p); one-sided beside failures."""
    moved = np.flatnonzero(steps > 0)
    offsets = np.diag(steps)[moved]
    found = simulator.many(np.vstack([point, point + offsets, point - offsets]))
    base, failed = found.outputs[0], np.reshape([each is not None for each in found.errors[1:]], (2, -1))
    high, low = np.where(failed[..., None, None], base, found.outputs[1:].reshape(2, -1, *base.shape))
    slopes = np.zeros((*base.shape, point.size))
    with np.errstate(invalid="ignore"):  # where both fail
        each = (high - low) / ((2 - failed.sum(axis=0)) * steps[moved])[:, None, None]
    slopes[..., moved] = np.moveaxis(each, 0, -1)
    if found.errors[0] is not None or np.isnan(slopes).any():
        raise next(error for error in found.errors if error is not None)
    return base, slopes


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
        math.sqrt(float((error**2 / variance[counted]).mean())) if known and variance[counted].all() else math.nan,
        float((np.abs(error) <= half[counted]).mean()) if known else math.nan,
    )
