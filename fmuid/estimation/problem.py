"""The problem of an identification: predictors, experiments and parameters as one stacked function of theta."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, numbers
from fmuid.data import (
    ArrayMeasurements,
    FunctionPredictor,
    JointPrior,
    MeasuredSeries,
    Measurements,
    Parameter,
    ParameterSet,
    Predictor,
    get_loss,
    measured_series,
    noise_levels,
    robust_variance,
)
from fmuid.data import Noise as Noise
from fmuid.errors import InputError, check_kind
from fmuid.estimation.marquardt.jacobian_cache import JacobianCache
from fmuid.estimation.model_sensitivities import SensitivityMethod
from fmuid.estimation.noise.output_series import OutputSeries, output_series, period_of
from fmuid.estimation.noise.periodic_error import check_periods
from fmuid.estimation.simulation_noise import LARGEST_VALUE, SimulationNoise, noise_level


class LeastSquares:
    """Anything that simulates, experiments and parameters: all that the estimators need, as functions of theta.

    `fmuid.Problem` is the one whose predictors run FMUs.

    Parameters
    ----------
    predictors : sequence of Predictor
        One an experiment; the thetas that it takes hold its experiment's values of the parameters, in the order of
        `parameters`.
    experiments : sequence of Measurements
    parameters : mapping of str to Parameter
    noise : Noise, optional
    joint_prior : JointPrior, optional
        Beside the priors of single parameters.
    loss : "linear", "soft_l1", "huber" or "cauchy"
        How the criterion grows with a sample's residual in standard deviations of the noise: all but "linear", the
        plain square, keep outliers from pulling (`fmuid.data.losses`). Priors always count by their squares.
    sensitivity : "finite-difference", "forward" or "fmu"
        How the derivatives of the outputs by the parameters are found
        (`fmuid.estimation.model_sensitivities.SENSITIVITIES`).
    derivatives : sequence of callable
        With other than finite differences: theta to the derivatives (N_i, K, n_outputs) of each predictor.

    Attributes
    ----------
    parameters : ParameterSet
    experiments : tuple
    output_names : tuple of str
        All measured outputs; those of the same name in several experiments share one noise variance.
    levels : NoiseLevels
        What is known of the noise.
    measured : (n,) array
        All counted samples, experiment by experiment, sample by sample; NaN of outputs that are names only
        (`check_measured`). Where the noise differs from sample to sample, they are divided by the `scale` of `levels`,
        as are `predict` and `derivatives`: what is left has noise of one variance for each output.
    groups : (n,) array of int
        Which output each of them belongs to.
    counts : (n_outputs,) array of int
        Samples of each output.
    variance : (n_outputs,) array
        The given noise variances, NaN where they are estimated; of samples that differ, their mean.
    first_variance : (n_outputs,) array
        Where the estimation of the variances starts, NaN where the residual decides.
    loss : Loss or None
        None for the plain sum of squares.
    one_of_many : bool
        Whether there are others that differ in their measurements only: all set out by the same simulations then.
    waypoints : JacobianCache or None
        Derivatives that were found on the way of another one of many.
    simulations, failures : int
        How many simulations of an experiment were made so far, and how many thetas could not be simulated.

    Raises
    ------
    InputError
        If there are no experiments, parameters, outputs or counted samples, too few for the parameters, or if there is
        no such loss.

    Examples
    --------
    >>> x, measured = np.array([0.0, 1.0, 2.0, 3.0]), [2.0, 0.75, 0.27, 0.1]
    >>> parameters = {"a": fmuid.Parameter(start=1.0), "k": fmuid.Parameter(start=0.5)}
    >>> problem = fmuid.LeastSquares.from_function(lambda p: p[0] * np.exp(-p[1] * x), measured, parameters)
    >>> fmuid.identify(problem).values.round(2)
    array([2.  , 0.99])
    """

    def __init__(
        self,
        predictors: Sequence[Predictor],
        experiments: Sequence[Measurements],
        parameters: Mapping[str, Parameter],
        *,
        noise: Noise | None = None,
        joint_prior: JointPrior | None = None,
        loss: str = "linear",
        sensitivity: str = "finite-difference",
        derivatives: Sequence[Callable[[Floats], Floats]] = (),
    ) -> None:
        if not experiments:
            raise InputError("there are no experiments; give at least one table with measured outputs")
        check_kind(
            noise, (Noise, type(None)), "noise must be a fmuid.Noise", "its variances by the names of the outputs"
        )
        self.parameters = ParameterSet(parameters, [e.name for e in experiments], joint_prior)
        self.experiments = tuple(experiments)
        self._predictors = tuple(predictors)
        self._derivatives = tuple(derivatives)
        self.sensitivity, self._refusal = sensitivity, ""
        noise = noise or Noise()
        self.noise, self.loss = noise, get_loss(loss)
        self.simulations = self.failures = 0
        self.one_of_many = False
        self.waypoints: JacobianCache | None = None
        self._reasons: dict[int, tuple[Floats, Exception | None]] = {}  # of the last failure, by experiment
        self.output_names = tuple(dict.fromkeys(name for e in experiments for name in e.output_names))
        if not self.output_names:
            raise InputError("no outputs are measured; name at least one output to compare with the simulation")
        self._counted = [np.flatnonzero(e.counted) for e in experiments]
        self.levels = noise_levels(noise, experiments, self.output_names)
        self.measured = self.stacked([e.output_values for e in experiments])
        columns = [np.array([self.output_names.index(n) for n in e.output_names], dtype=np.intp) for e in experiments]
        self.groups = np.concatenate(
            [np.tile(c, len(e.times))[kept] for e, c, kept in zip(experiments, columns, self._counted, strict=True)]
        )
        self.counts = np.bincount(self.groups, minlength=len(self.output_names))
        self.variance, self.first_variance = self.levels.variance, self.levels.first
        self._check_counts()
        if noise.excitation_period or noise.experiments:
            check_periods(self.series, noise, len(parameters))

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
        """Make a problem of a Python function instead of an FMU.

        Parameters
        ----------
        function : callable
            Theta (N,), in the order of `parameters`, to outputs (K,) or (K, n_outputs). An `ArithmeticError`, a
            `SimulationError` or an output that is not finite counts as a simulation that failed.
        measured : (K,) or (K, n_outputs) array
            NaN where a sample is missing.
        parameters : mapping of str to Parameter
        times : (K,) array, optional
            For tables and figures; default 0, 1, 2, ...
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
        table = ArrayMeasurements("experiment", clock, tuple(outputs), values, ~np.isnan(values))
        predictor = FunctionPredictor(function, values.shape)
        return LeastSquares([predictor], [table], parameters, noise=noise, joint_prior=joint_prior, loss=loss)

    @property
    def models(self) -> dict[str, dict[str, Any]]:
        """``name``, ``digest`` and ``run`` (how it is run) of each FMU by its component; none here."""
        return {}

    @property
    def units(self) -> dict[str, str]:
        """The units of the parameters that have one; none are known here."""
        return {}

    @property
    def data(self) -> tuple[MeasuredSeries, ...]:
        """Which measurements there are; of one of many problems nobody asks."""
        asked = () if self.one_of_many else self.experiments
        return tuple(series for experiment in asked for series in measured_series(experiment))

    @cached_property
    def series(self) -> tuple[OutputSeries, ...]:
        """Which counted samples belong to one output of one experiment, and where they stand in time."""
        return output_series(self.experiments, self.output_names)

    @cached_property
    def periods(self) -> dict[str, float]:
        """After how long, s, each experiment's excitation repeats, as is said or its inputs show, 0 where not."""
        return {each.name: self.noise.period_in(each.name) or period_of(each) for each in self.experiments}

    def _check_counts(self) -> None:
        for name, count in zip(self.output_names, self.counts, strict=True):
            if count == 0:
                raise InputError(
                    f"output {name!r} has no sample that counts: all are missing or discarded; "
                    "shorten discard or leave the output out"
                )
            largest = float(np.max(np.abs(self.measured[self.groups == self.output_names.index(name)])))
            if largest >= LARGEST_VALUE:
                raise InputError(
                    f"a sample of output {name!r} is {largest:g} in magnitude; leave it empty or change the unit"
                )
        rows = self.measured.size + len(self.parameters.prior_whitening)
        if rows < len(self.parameters) or (np.isnan(self.variance).all() and rows == len(self.parameters)):
            raise InputError(
                f"{self.measured.size} counted samples are too few for {len(self.parameters)} parameters; "
                "measure more, estimate fewer, or give priors"
            )

    def check_measured(self) -> None:
        """Check that all outputs have been measured (`InputError`); without that a problem can be simulated only."""
        missing = self.groups[np.isnan(self.measured)]
        if missing.size:
            name = self.output_names[missing[0]]
            raise InputError(f"output {name!r} has not been measured: there is nothing to identify from it")

    def stacked(self, tables: Sequence[Floats]) -> Floats:
        """Return the counted samples (n,) of the outputs (K, n_outputs) of each experiment, as `measured` has them."""
        rows = np.concatenate([own.ravel()[kept] for own, kept in zip(tables, self._counted, strict=True)])
        return self._weighed(rows)

    def _weighed(self, rows: Floats) -> Floats:
        """Return rows (..., n) with noise of one variance for each output."""
        return rows if self.levels.scale is None else rows / self.levels.scale

    def tables(self, rows: Floats) -> list[Floats]:
        """Return counted samples (n,) where they stand in the tables (K, n_outputs), NaN where none counts."""
        found, last = [], 0
        for experiment, kept in zip(self.experiments, self._counted, strict=True):
            first, last = last, last + kept.size
            table = np.full(experiment.output_values.shape, np.nan)
            table.ravel()[kept] = rows[first:last]
            found.append(table)
        return found

    def predict(self, thetas: Floats) -> Floats:
        """Simulate thetas (m, N) and return all counted samples (m, n), NaN rows where a simulation failed.

        The array is the caller's to change.
        """
        blocks = []
        for index, kept in enumerate(self._counted):
            flat = self._outputs(index, thetas).reshape(len(thetas), -1)
            blocks.append(flat if kept.size == flat.shape[1] else flat[:, kept])
        # what failed is NaN throughout; an experiment may have no sample
        failed = np.any([np.isnan(block[:, :1]).any(axis=1) for block in blocks], axis=0)
        self.failures += int(failed.sum())
        stacked = blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)
        stacked[failed] = np.nan
        return self._weighed(stacked)

    def noise_near(self, theta: Floats) -> tuple[Floats, SimulationNoise]:
        """Return the counted samples (n,) at theta (N,), NaN where it fails, and the noise of the simulation there."""
        given, groups = self.parameters, self.groups
        bounds = given.lower, given.upper
        return noise_level(self.predict, theta, given.magnitudes(theta), *bounds, groups, self.counts.size)

    def derivatives(self, theta: Floats) -> Floats:
        """Return the derivatives (N, n) of all counted samples by the parameters at theta (N,), from the model.

        Raises
        ------
        SensitivityUnavailableError
            If the model cannot give them there.
        """
        blocks = []
        for index, (kept, derivatives) in enumerate(zip(self._counted, self._derivatives, strict=True)):
            _, columns = self.parameters.for_experiment(index)
            self.simulations += 1
            block = np.zeros((theta.size, kept.size))
            np.add.at(block, columns, derivatives(theta[columns]).reshape(columns.size, -1)[:, kept])
            blocks.append(block)
        return self._weighed(np.concatenate(blocks, axis=1))

    def refuse_derivatives(self, reason: str) -> None:
        """Note why differences serve in place of the derivatives of the model."""
        self._refusal = reason

    @property
    def used_sensitivity(self) -> SensitivityMethod:
        """How the derivatives were found."""
        by_differences = any(getattr(each, "by_differences", False) for each in self._derivatives)
        return SensitivityMethod(self.sensitivity, by_differences, self._refusal)

    def outputs(self, theta: ArrayLike, predicted: Floats | None = None, *, simulate: bool = True) -> list[Floats]:
        """Simulate one theta (N,) and return every experiment's outputs (K, n_outputs), NaN where failed.

        Parameters
        ----------
        theta : (N,) array
        predicted : (n,) array, optional
            Its counted samples, as `predict` gave them: experiments all of whose samples count are not simulated again.
        simulate : bool
            False: nothing is simulated where `predicted` is given, and samples that do not count are NaN.
        """
        thetas = np.array(theta, dtype=np.float64)[None]
        if predicted is None:
            return [self._outputs(index, thetas)[0] for index in range(len(self.experiments))]
        known = self.tables(predicted if self.levels.scale is None else predicted * self.levels.scale)
        for index, (experiment, kept) in enumerate(zip(self.experiments, self._counted, strict=True)):
            if simulate and kept.size < experiment.output_values.size:
                known[index] = self._outputs(index, thetas)[0]
        return known

    def _outputs(self, index: int, thetas: Floats) -> Floats:
        _, columns = self.parameters.for_experiment(index)
        if columns.size == thetas.shape[1] or len(thetas) == 1:
            self.simulations += len(thetas)
            return self._simulated(index, thetas[:, columns])
        # what only other experiments depend on leaves this one as it is
        own, back = np.unique(thetas[:, columns], axis=0, return_inverse=True)
        self.simulations += len(own)
        return self._simulated(index, own)[back.ravel()]

    def _simulated(self, index: int, thetas: Floats) -> Floats:
        found = self._predictors[index].many(thetas)
        first = next((i for i, error in enumerate(found.errors) if error is not None), None)
        if first is not None:  # the one whose reason was asked for
            self._reasons[index] = thetas[first].copy(), found.errors[first]
        return found.outputs

    def failure(self, theta: Floats) -> Exception | None:
        """Return why the simulation at theta (N,) fails, None if it does not."""
        for index, predictor in enumerate(self._predictors):
            _, columns = self.parameters.for_experiment(index)
            known, error = self._reasons.get(index, (None, None))
            if known is None or not np.array_equal(known, theta[columns]):  # what fails may take its time about it
                (error,) = predictor.many(theta[None, columns]).errors
            if error is not None:
                return error
        return None

    def squares(self, residual: Floats) -> Floats:
        """Return the sum of squares of each output (n_outputs,) of a residual (n,)."""
        return np.bincount(self.groups, weights=residual**2, minlength=self.counts.size).astype(np.float64)

    def output_variances(self, residual: Floats, shares: Floats | None = None) -> Floats:
        """Return σ̂² = J_j/(K_j − share_j) of each output (1.12), (n_outputs,).

        Parameters
        ----------
        residual : (n,) array
            Measured − simulated, as `measured`.
        shares : (n_outputs,) array, optional
            How many of the estimated parameters each output pays for; default none, as J(θ)/K of (1.51).
        """
        sums = self.squares(residual)
        free = np.maximum(self.counts - (0.0 if shares is None else shares), np.finfo(float).eps)
        return np.asarray(self.levels.pooled(sums, free) / free, dtype=np.float64)

    def noise_variances(self, residual: Floats, shares: Floats | None = None) -> Floats:
        """Return the noise variance of each output that a residual tells of, (n_outputs,).

        That of `output_variances`; with a robust loss Huber's proposal 2, which outliers do not inflate either.
        """
        if self.loss is None:
            return self.output_variances(residual, shares)
        free = self.counts - (0.0 if shares is None else shares)
        found = np.array([robust_variance(residual[self.groups == j], free[j]) for j in range(self.counts.size)])
        for pool in self.levels.pools:
            own, share = np.isin(self.groups, pool), self.levels.share
            common = robust_variance(residual[own] / np.sqrt(share[self.groups[own]]), float(free[pool].sum()))
            found[pool] = share[pool] * common
        return found
