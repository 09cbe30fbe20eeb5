"""Groups of a result: fit, identifiability, history with its restarts and optima, setup."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from fmuid import codec
from fmuid.array_types import Floats
from fmuid.data import Experiment, MeasuredSeries
from fmuid.estimation.covariance import LIMITS, WeakDirection
from fmuid.estimation.finite_differences import SensitivityMethod
from fmuid.estimation.linearized_problem import LinearizedProblem
from fmuid.estimation.noise.output_noise import OutputNoise
from fmuid.estimation.noise.sandwich import ResidualNoise
from fmuid.estimation.search.state import Iteration, TerminationReason
from fmuid.estimation.solver_check import UsedModel


@dataclass(frozen=True, eq=False)
class Optimum:
    """A local optimum of a global search.

    Attributes
    ----------
    theta : (N,) array
    criterion : float
        Cost (1.37) with the noise variances of the best optimum.
    hits : int
        Number of fits that ended here.
    outcome : TerminationReason
        Termination of the best of these fits.
    fit : Result or None
        That fit; None if read from a file.
    """

    theta: Floats
    criterion: float
    hits: int
    outcome: TerminationReason
    fit: Any = field(default=None, repr=False)

    json_layout: ClassVar = codec.Layout(omitted={"fit"}, derived=("converged",))

    @property
    def converged(self) -> bool:
        """True if the fit converged."""
        return self.outcome.converged


class StartingPointSource(Enum):
    """Origin of a starting point; the values stand in ``result.json``."""

    GIVEN = "given"  # by the user
    EQUATION_ERROR = "equation_error"  # equation-error estimate at the measured states (`WeakForm`)
    CORRECTION = "correction"  # best fit of simulations with states corrected at each sample
    SOBOL = "sobol"  # best of a few points of the box


class SearchFailure(Enum):
    """Defect of a starting point, or of its optimum."""

    NONE = "none"
    FAR = "far"  # fails or is worse than the mean of an output; not optimized
    FAILED = "failed"  # the simulation fails
    NO_EFFECT = "no_effect"  # a parameter has no effect there, or the optimization cannot begin
    UNFINISHED = "unfinished"  # stalled, or ended at a limit
    LARGE_RESIDUAL = "large_residual"  # above `MAX_NOISE_RATIO` times the noise level
    MODEL_ERROR = "model_error"  # likewise, and other starting points lead to the same optimum


@dataclass(frozen=True)
class RestartAttempt:
    """One starting point that was tried.

    Attributes
    ----------
    remedy : StartingPointSource
    trouble : SearchFailure
    noise_ratio : float
        Largest RMS residual of an output by its noise level; NaN if unknown.
    simulations : int
    kept : bool
        True for the starting point of the result.
    """

    remedy: StartingPointSource
    trouble: SearchFailure
    noise_ratio: float = math.nan
    simulations: int = 0
    kept: bool = False


@dataclass(frozen=True)
class CombinationFit:
    """Fit with one combination of discrete parameters.

    Attributes
    ----------
    values : mapping of str to float, int, bool or str
    outcome : TerminationReason or None
        None if it could not begin.
    behind : float
        −2 ln L above the best one's, with the prior; infinite if it did not terminate.
    estimates : mapping of str to float
        Of the other parameters.
    """

    values: Mapping[str, float | int | bool | str]
    outcome: TerminationReason | None
    behind: float
    estimates: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class AcquisitionDelay:
    """Delay of the outputs behind the inputs, estimated beside the parameters (`Noise.delay_std`).

    Attributes
    ----------
    samples, std : float
        Estimate and σ.
    widening : (N,) array
        Factor of each parameter's σ by this unknown delay.
    """

    samples: float
    std: float
    widening: Floats


@dataclass(frozen=True, eq=False)
class Fit:
    """Agreement of model and data at the estimates.

    Attributes
    ----------
    cost : float
        Cost (1.37) with the noise variances of the last search.
    log_likelihood : float
        Of the data, without priors; NaN with a robust loss.
    degrees_of_freedom : float
        Of the noise variances: K − N if they are estimated, infinite if all are given.
    noise_variance : mapping of str to float
        Estimated residual variance of each output, J_j/(K_j − share of N) (1.12).
    given_variance : mapping of str to float
        Given variances (docs/method/noise-variances.md).
    output_noise : mapping of str to OutputNoise
        Lines, color and tails of each output's residual.
    linearization : LinearizedProblem or None
        Problem linearized at the estimates; None if read from a file.
    noise : ResidualNoise or None
        Noise model of the residuals; None if read from a file.
    experiments : tuple of Experiment
        Empty if read from a file.
    simulated : tuple of (K, n_outputs) arrays
        Simulated outputs of each experiment.
    delay : AcquisitionDelay or None
        None without inputs, or where the noise has no `delay_std`.
    """

    cost: float
    log_likelihood: float
    degrees_of_freedom: float
    noise_variance: Mapping[str, float]
    given_variance: Mapping[str, float]
    output_noise: Mapping[str, OutputNoise] = field(default_factory=dict)
    linearization: LinearizedProblem | None = None
    noise: ResidualNoise | None = None
    experiments: tuple[Experiment, ...] = ()
    simulated: tuple[Floats, ...] = ()
    delay: AcquisitionDelay | None = None

    json_layout: ClassVar = codec.Layout(omitted={"linearization", "noise", "experiments", "simulated"})

    @property
    def is_noisy(self) -> bool:
        """True if each residual exceeds rounding and simulation errors."""
        squares: dict[str, float] = dict.fromkeys(self.noise_variance, 0.0)
        for each in self.experiments:
            for name, values in zip(each.output_names, each.output_values.T, strict=True):
                squares[name] = max(squares[name], float(np.nanmean(values**2)))
        return all(self.noise_variance[name] > LIMITS.rounding_share**2 * square for name, square in squares.items())

    @property
    def variance(self) -> dict[str, float]:
        """Noise variances that weight the outputs: given, otherwise estimated."""
        return {**self.noise_variance, **self.given_variance}

    @cached_property
    def frames(self) -> tuple[pd.DataFrame, ...]:
        """A table per experiment: time or row, and ``measured.<output>`` and ``simulated.<output>`` of each output."""
        frames = []
        for experiment, simulated in zip(self.experiments, self.simulated, strict=True):
            columns = experiment.axis
            for k, name in enumerate(experiment.output_names):
                columns[f"measured.{name}"] = experiment.output_values[:, k]
                columns[f"simulated.{name}"] = simulated[:, k]
            frames.append(pd.DataFrame(columns))
        return tuple(frames)


@dataclass(frozen=True)
class Identifiability:
    """Directions in parameter space that the data determine poorly (`fmuid.estimation.covariance`).

    Attributes
    ----------
    non_identifiable : tuple of WeakDirection
        The data do not change along them.
    weakly_identifiable : tuple of WeakDirection
        Standard deviations above the parameters' magnitudes.
    prior_dominated : tuple of WeakDirection
        Only the prior determines them.
    replaced_initial_guess : tuple of str
        Parameters without effect at the given initial guess, which was replaced.
    """

    non_identifiable: tuple[WeakDirection, ...] = ()
    weakly_identifiable: tuple[WeakDirection, ...] = ()
    prior_dominated: tuple[WeakDirection, ...] = ()
    replaced_initial_guess: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class History:
    """Course of an identification.

    Attributes
    ----------
    iterations, simulations : int
    elapsed_s : float
    trace : tuple of (int, Iteration)
        All iterations, each with the number of its round.
    rounds : tuple of mapping
        Noise variances used and estimated in each round (docs/method/noise-variances.md).
    restarts : tuple of RestartAttempt
        Initial guesses that were tried; empty if the given one succeeded.
    optima : tuple of Optimum
        Local optima of a global search, the best first.
    fits : int or None
        Number of local searches of a global search.
    combinations : tuple of CombinationFit
        Combinations of discrete parameters, the best first.
    """

    iterations: int = 0
    simulations: int = 0
    elapsed_s: float = 0.0
    trace: tuple[tuple[int, Iteration], ...] = ()
    rounds: tuple[Mapping[str, float], ...] = ()
    restarts: tuple[RestartAttempt, ...] = ()
    optima: tuple[Optimum, ...] = ()
    fits: int | None = None
    combinations: tuple[CombinationFit, ...] = ()

    json_layout: ClassVar = codec.Layout(omitted={"trace"})

    def after(self, earlier: History) -> History:
        """Return this history as the continuation of an earlier one."""
        last, steps = len(earlier.rounds), max((step.number for _, step in earlier.trace), default=0)
        trace = tuple((last + n, replace(step, number=steps + step.number)) for n, step in self.trace)
        rounds = tuple({**each, "round": last + each["round"]} for each in self.rounds)
        total = earlier.iterations + self.iterations
        return replace(self, iterations=total, trace=earlier.trace + trace, rounds=earlier.rounds + rounds)


@dataclass(frozen=True, eq=False)
class Setup:
    """Models, data and methods behind the estimates.

    Attributes
    ----------
    version : str
        Of fmuid.
    models : mapping of str to mapping
        ``name``, ``digest`` and ``run`` (fields of a `fmuid.models.SolverConfiguration`) of each FMU by its component;
        a single one is the component ``""``. Empty for problems without FMUs.
    sensitivity : SensitivityMethod or None
        Method for the Jacobian.
    data : tuple of MeasuredSeries
        Measurements that were used.
    observer : float or None
        Memory of the observer in samples (`fmuid.identification.with_observer`).
    made_with : object
        `fmuid.identification.ModelReference` for `predict`, or the path of the file it was read from.
    """

    version: str
    models: Mapping[str, UsedModel] = field(default_factory=dict)
    sensitivity: SensitivityMethod | None = None
    data: tuple[MeasuredSeries, ...] = ()
    observer: float | None = None
    made_with: object = field(default=None, repr=False)

    json_layout: ClassVar = codec.Layout(omitted={"made_with"})
