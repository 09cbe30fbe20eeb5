"""Least-squares problem: predictors, data and parameters; immutable."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, numbers
from fmuid.data import (
    Experiment,
    JointPrior,
    MeasuredSeries,
    Parameter,
    ParameterSet,
    get_loss,
    measured_series,
    noise_levels,
    robust_variance,
)
from fmuid.data import Noise as Noise
from fmuid.errors import InputError, check_kind
from fmuid.estimation.noise.output_series import OutputSeries, output_series, period_of
from fmuid.estimation.noise.periodic_error import check_periods
from fmuid.estimation.predictors import FunctionPredictor, Predictor
from fmuid.estimation.simulation_noise import NOISE
from fmuid.estimation.solver_check import UsedModel
from fmuid.estimation.starting_points import second_difference_noise, smoothness_noise


class LeastSquares:
    """Least-squares problem of any predictors; immutable.

    `fmuid.Problem` is the one for FMUs; `fmuid.estimation.Evaluator` simulates it.

    Parameters
    ----------
    predictors : sequence of Predictor
        One per experiment.
    experiments : sequence of Experiment
    parameters : mapping of str to Parameter
    noise : Noise, optional
    joint_prior : JointPrior, optional
        In addition to the priors of single parameters.
    loss : "linear", "soft_l1", "huber" or "cauchy"
        Robust loss of each residual in σ of the noise; priors stay quadratic.
    sensitivity : "finite-difference", "forward" or "fmu"
        Method of the derivatives.
    derivatives : sequence of callable
        Model derivatives: theta to (N_i, K, n_outputs), one per predictor.

    Attributes
    ----------
    parameters : ParameterSet
    experiments : tuple
    output_names : tuple of str
        Measured outputs; equal names share one noise variance.
    levels : NoiseLevels
        Known noise.
    measured : (n,) array
        Counted samples of all experiments, divided by `levels.scale` if the noise varies.
    groups : (n,) array of int
        Output index of each sample.
    counts : (n_outputs,) array of int
        Samples per output.
    variance : (n_outputs,) array
        Given noise variances, NaN if estimated.
    first_variance : (n_outputs,) array
        Initial noise variances, NaN if taken from the residual.
    loss : Loss or None
        None if linear.
    predictors, derivatives : tuple
    kept : tuple of (n_i,) arrays of int
        Counted samples in the flattened outputs of each experiment.

    Raises
    ------
    InputError
        If something is missing, samples are too few, or the loss is unknown.

    Examples
    --------
    >>> x, measured = np.array([0.0, 1.0, 2.0, 3.0]), [2.0, 0.75, 0.27, 0.1]
    >>> parameters = {"a": fmuid.Parameter(start=1.0), "k": fmuid.Parameter(start=0.5)}
    >>> problem = fmuid.estimation.LeastSquares.from_function(lambda p: p[0] * np.exp(-p[1] * x), measured, parameters)
    >>> fmuid.identify(problem).values.round(2)
    array([2.  , 0.99])
    """

    identity: object
    refinement: Any = None
    """Solver refinement; None for functions."""

    def __init__(
        self,
        predictors: Sequence[Predictor],
        experiments: Sequence[Experiment],
        parameters: Mapping[str, Parameter],
        *,
        noise: Noise | None = None,
        joint_prior: JointPrior | None = None,
        loss: str = "linear",
        sensitivity: str = "finite-difference",
        derivatives: Sequence[Callable[[Floats], Floats]] = (),
    ) -> None:
        if not experiments:
            raise InputError("no experiments. Give at least one with measured outputs.")
        check_kind(
            noise, (Noise, type(None)), "noise must be a fmuid.Noise", "its variances by the names of the outputs"
        )
        vars(self).setdefault("identity", object())  # of its predictors; `measuring` keeps it
        self.given_parameters, self.joint_prior, self.loss_name = parameters, joint_prior, loss
        self.parameters = ParameterSet(parameters, [e.name for e in experiments], joint_prior)
        self.experiments = tuple(experiments)
        self.predictors, self.derivatives, self.sensitivity = tuple(predictors), tuple(derivatives), sensitivity
        noise = noise or Noise()
        self.noise, self.loss = noise, get_loss(loss)
        self.output_names = tuple(dict.fromkeys(name for e in experiments for name in e.output_names))
        if not self.output_names:
            raise InputError("no outputs are measured. Name at least one.")
        self.kept = tuple(np.flatnonzero(e.counted) for e in experiments)
        self.levels = noise_levels(noise, experiments, self.output_names)
        self.measured = self.stacked([e.output_values for e in experiments])
        columns = [np.array([self.output_names.index(n) for n in e.output_names], dtype=np.intp) for e in experiments]
        self.groups = np.concatenate(
            [np.tile(c, len(e.times))[kept] for e, c, kept in zip(experiments, columns, self.kept, strict=True)]
        )
        self.counts = np.bincount(self.groups, minlength=len(self.output_names))
        self.variance, self.first_variance = self.levels.variance, self.levels.first
        self._check_counts()
        if noise.excitation_period or noise.experiments:
            check_periods(self.series, noise, len(parameters))
        self._frozen = True

    def __setattr__(self, name: str, value: object) -> None:
        if "_frozen" in vars(self):
            raise AttributeError(f"a problem does not change: {name} is not to be set; make another problem")
        super().__setattr__(name, value)

    def _with(self, **changed: object) -> Self:
        other = copy.copy(self)
        vars(other).pop("layout", None)
        vars(other).update(changed)
        return other

    @cached_property
    def layout(self) -> Hashable:
        """Key of everything but the measurements."""
        scale = () if self.levels.scale is None else self.levels.scale.tobytes()
        return self.identity, *(kept.tobytes() for kept in self.kept), scale, self.parameters.names

    def finer(self, refinement: Any) -> Self:  # noqa: ARG002 - systems have
        """Return this problem with a solver refinement; functions have none."""
        return self

    def afresh(self) -> Self:
        """Return this problem with predictors without history."""
        return self

    def as_in(self, result: Any) -> Self:  # noqa: ARG002 - systems differ
        """Return this problem with the simulation settings of a result."""
        return self

    def directions(self, result: Any, sizes: Mapping[Any, float] | None = None) -> tuple[Any, ...]:  # noqa: ARG002 - systems have
        """Return the directions of model errors at a result; functions have none."""
        return ()

    def process_noise(self, result: Any) -> Any:  # noqa: ARG002 - systems have
        """Return the process noise of a result; functions have none."""
        return None

    def doubtful_rows(self, result: Any) -> dict[str, tuple[int, str]]:  # noqa: ARG002 - systems have
        """Return the first doubtful row (from 0) of experiments, with reason."""
        return {}

    def other_conventions(self, result: Any) -> Iterable[tuple[str, str, str, float]]:  # noqa: ARG002 - as above
        """Return responses that fit otherwise: convention, response, experiment and fit, %."""
        return ()

    def measuring(self, experiments: Sequence[Experiment], parameters: Mapping[str, Parameter] | None = None) -> Self:
        """Return this problem with other measured values, and other initial guesses."""
        other = copy.copy(self)
        for name in ("_frozen", "layout", "series", "periods", "shown_noise"):
            vars(other).pop(name, None)
        LeastSquares.__init__(
            other,
            self.predictors,
            experiments,
            self.given_parameters if parameters is None else parameters,
            noise=self.noise,
            joint_prior=self.joint_prior,
            loss=self.loss_name,
            sensitivity=self.sensitivity,
            derivatives=self.derivatives,
        )
        return other

    @staticmethod
    def from_function(
        function: Callable[[Floats], ArrayLike],
        measured: ArrayLike,
        parameters: Mapping[str, Parameter],
        *,
        times: ArrayLike | None = None,
        outputs: Sequence[str] = ("y",),
        noise: Noise | None = None,
        joint_prior: JointPrior | None = None,
        loss: str = "linear",
    ) -> LeastSquares:
        """Return the problem of a Python function.

        Parameters
        ----------
        function : callable
            Theta (N,) to outputs (K,) or (K, n_outputs). `ArithmeticError`, `SimulationError` or a non-finite output
            is a failed simulation.
        measured : (K,) or (K, n_outputs) array
            NaN if a sample is missing.
        parameters : mapping of str to Parameter
        times : (K,) array, optional
            Default: 0, 1, 2, ...
        outputs : sequence of str
            Names of the outputs.
        noise, joint_prior, loss
            As for `LeastSquares`.
        """
        values = numbers(measured, "measured")
        values = values[:, None] if values.ndim == 1 else values
        if values.ndim != 2 or values.shape[1] != len(outputs):
            raise InputError(f"measured needs one column for each of {', '.join(outputs)}; its shape is {values.shape}")
        clock = np.arange(len(values), dtype=np.float64) if times is None else numbers(times, "times")
        if clock.shape != (len(values),):
            raise InputError(f"times must have {len(values)} values, one a sample; its shape is {clock.shape}")
        table = Experiment.of_arrays("experiment", clock, tuple(outputs), values, ~np.isnan(values))
        predictor = FunctionPredictor(function, values.shape)
        return LeastSquares([predictor], [table], parameters, noise=noise, joint_prior=joint_prior, loss=loss)

    @property
    def models(self) -> dict[str, UsedModel]:
        """``name``, ``digest`` and ``run`` of each FMU by component; empty for functions."""
        return {}

    @property
    def units(self) -> dict[str, str]:
        """Units of the parameters; empty for functions."""
        return {}

    @property
    def data(self) -> tuple[MeasuredSeries, ...]:
        """All measured series."""
        return tuple(series for experiment in self.experiments for series in measured_series(experiment))

    @cached_property
    def series(self) -> tuple[OutputSeries, ...]:
        """Counted samples as series in time, one per output and experiment."""
        return output_series(self.experiments, self.output_names)

    @cached_property
    def shown_noise(self) -> Floats:
        """Noise level (n_outputs,) from second differences of the data; NaN where samples have no order."""
        squares, counts, ordered = *np.zeros((2, self.counts.size)), np.zeros(self.counts.size, dtype=np.bool_)
        scales = self.tables(np.ones(self.measured.size) if self.levels.scale is None else self.levels.scale)
        for experiment, tables, scale in zip(self.experiments, self.tables(self.measured), scales, strict=True):
            order = experiment.smooth_over
            if order is None:
                continue
            at = np.argsort(order, kind="stable")
            for name, values, counted in zip(experiment.output_names, tables.T, experiment.counted.T, strict=True):
                j, own = self.output_names.index(name), np.where(counted, values, np.nan)
                size = int(counted.sum())
                if experiment.kind == "time":
                    found = second_difference_noise(order, own)
                else:
                    weight = scale[:, experiment.output_names.index(name)]
                    found = smoothness_noise(order[at], (own * weight)[at], weight[at])
                ordered[j] |= experiment.kind == "time" or math.isfinite(found)
                if math.isfinite(found):
                    squares[j] += size * found**2
                    counts[j] += size
        # constant or stepped outputs: rounding of the largest value
        floor = [1e-9 * float(np.max(np.abs(self.measured[self.groups == j]))) for j in range(counts.size)]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(ordered, np.fmax(np.sqrt(squares / counts), np.maximum(floor, 1e-300)), np.nan)

    @cached_property
    def periods(self) -> dict[str, float]:
        """Period of each experiment's excitation, s; 0 if it does not repeat."""
        return {each.name: self.noise.period_in(each.name) or period_of(each) for each in self.experiments}

    def _check_counts(self) -> None:
        for name, count in zip(self.output_names, self.counts, strict=True):
            if count == 0:
                raise InputError(
                    f"output {name!r} has no scored sample: all are missing or in the warm-up. "
                    "Shorten warmup or remove the output."
                )
            largest = float(np.max(np.abs(self.measured[self.groups == self.output_names.index(name)])))
            if largest >= NOISE.largest_value:
                raise InputError(
                    f"a sample of output {name!r} is {largest:g} in magnitude. Delete it or change the unit."
                )
        rows = self.measured.size + len(self.parameters.prior_whitening)
        if rows < len(self.parameters) or (np.isnan(self.variance).all() and rows == len(self.parameters)):
            raise InputError(
                f"{self.measured.size} counted samples are too few for {len(self.parameters)} parameters. "
                "Measure more, fix some, or add priors."
            )

    def check_measured(self) -> None:
        """Check that all outputs are measured (`InputError`)."""
        missing = self.groups[np.isnan(self.measured)]
        if missing.size:
            name = self.output_names[missing[0]]
            raise InputError(f"output {name!r} has not been measured")

    def stacked(self, tables: Sequence[Floats]) -> Floats:
        """Return counted samples (n,) of each experiment's outputs (K, n_outputs)."""
        rows = np.concatenate([own.ravel()[kept] for own, kept in zip(tables, self.kept, strict=True)])
        return self.scaled(rows)

    def scaled(self, rows: Floats) -> Floats:
        """Return rows (..., n) divided by the noise scale of each sample."""
        return rows if self.levels.scale is None else rows / self.levels.scale

    def unscaled(self, rows: Floats) -> Floats:
        """Invert `scaled`."""
        return rows if self.levels.scale is None else rows * self.levels.scale

    def tables(self, rows: Floats) -> list[Floats]:
        """Return counted samples (n,) as tables (K, n_outputs), NaN elsewhere."""
        found, last = [], 0
        for experiment, kept in zip(self.experiments, self.kept, strict=True):
            first, last = last, last + kept.size
            table = np.full(experiment.output_values.shape, np.nan)
            table.ravel()[kept] = rows[first:last]
            found.append(table)
        return found

    def noise_ratio(self, variance: Mapping[str, float]) -> float:
        """Return the largest standard deviation of a residual over its `shown_noise`; NaN without one."""
        ratios = np.sqrt([variance[name] for name in self.output_names]) / self.shown_noise
        return float(np.nanmax(ratios)) if np.isfinite(ratios).any() else math.nan

    def squares(self, residual: Floats) -> Floats:
        """Return the sum of squares (n_outputs,) of a residual (n,)."""
        return np.bincount(self.groups, weights=residual**2, minlength=self.counts.size).astype(np.float64)

    def output_variances(self, residual: Floats, shares: Floats | None = None) -> Floats:
        """Return σ̂² = J_j/(K_j − share_j) (1.12) of each output from a residual (n,); no shares as in (1.51)."""
        sums = self.squares(residual)
        free = np.maximum(self.counts - (0.0 if shares is None else shares), np.finfo(float).eps)
        return np.asarray(self.levels.pooled(sums, free) / free, dtype=np.float64)

    def noise_variances(self, residual: Floats, shares: Floats | None = None) -> Floats:
        """Return the noise variance of each output: `output_variances`, with a robust loss Huber's proposal 2."""
        if self.loss is None:
            return self.output_variances(residual, shares)
        free = self.counts - (0.0 if shares is None else shares)
        found = np.array([robust_variance(residual[self.groups == j], free[j]) for j in range(self.counts.size)])
        for pool in self.levels.pools:
            own, share = np.isin(self.groups, pool), self.levels.share
            common = robust_variance(residual[own] / np.sqrt(share[self.groups[own]]), float(free[pool].sum()))
            found[pool] = share[pool] * common
        return found
