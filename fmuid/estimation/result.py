"""The result of an identification: estimates, their uncertainty, and how they came about."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from scipy import special

from fmuid import codec
from fmuid.array_types import Floats
from fmuid.data import Experiment, JointPrior, MeasuredSeries, Normal, measured_series
from fmuid.display_mixins import MultilineText, PredictMixin, text_of
from fmuid.errors import InputError
from fmuid.estimation.covariance import ActiveBound, WeakDirection, check_level
from fmuid.estimation.iteration_history import History
from fmuid.estimation.linearized_problem import LinearizedProblem
from fmuid.estimation.local_optimum import Optimum
from fmuid.estimation.model_sensitivities import SensitivityMethod
from fmuid.estimation.noise.sandwich import ResidualNoise
from fmuid.estimation.parameter_estimate import ParameterEstimate
from fmuid.estimation.search.loop import TerminationReason
from fmuid.estimation.solver_check.outcome import SolverCheck, UsedModel
from fmuid.estimation.starting_points.outcome import CombinationFit, RestartAttempt
from fmuid.formatting import with_std

# Estimates correlated more strongly than this move together: their intervals must not be read one by one.
STRONG_CORRELATION = 0.95
# Handed on as a prior, an estimate keeps its interval of this level.
PRIOR_LEVEL = 0.95
# Parameters that a result names where it is printed in a line.
LINE_PARAMETERS = 8
RESULT_SCHEMA = "fmuid/result/2"


@dataclass(frozen=True, eq=False)
class Result(PredictMixin):
    """What an identification found.

    Attributes
    ----------
    outcome : TerminationReason
        How the search ended.
    names : tuple of str
    values, start : (N,) arrays
    lower, upper : (N,) arrays
        The bounds, infinite where there are none.
    prior_mean, prior_std : (N,) arrays
        NaN where there is no prior.
    covariance : (N, N) array
        Local covariance of the estimates under noise of the colour that the residual shows
        (`fmuid.estimation.noise.sandwich`); infinite variances where a parameter is not determined, all NaN where the
        search stalled.
    white_covariance : (N, N) array
        What it would be if the noise were white (1.31).
    freedom : (N,) array
        Degrees of freedom of the variances on the diagonal of `covariance`; infinite where they are known.
    noise_variance : dict of str to float
        The estimated variance σ̂² of each output's residual, J_j/(K_j − share of N) (1.12).
    given_variance : dict of str to float
        The variances of the outputs for which one was given, for the consistency check of docs/method.md section 7.
    criterion : float
        The compound criterion (1.37) at the estimate with the variances that the last search used.
    log_likelihood : float
        Of the data at the estimate, without priors (`LeastSquares.log_likelihood`). NaN with a robust loss.
    degrees_of_freedom : float
        Of the noise variances: K − N where they are estimated, infinite where all are given.
    iterations, simulations : int
    elapsed_s : float
    undetermined, weak, prior_determined : tuple of WeakDirection
        Directions in which the estimates could move without effect, or next to none (`fmuid.estimation.covariance`);
        that are determined to no better than the parameters' own magnitudes; that the data leave to the prior.
    at_bounds : tuple of ActiveBound
        Parameters that the data would push beyond a bound.
    version : str
        Of fmuid.
    models : mapping of str to mapping
        ``name``, ``digest`` and ``run`` (the fields of a `fmuid.models.SolverConfiguration`) of each FMU by its
        component; a single one is the component ``""``. Empty for problems that are not made of FMUs.
    sensitivity : SensitivityMethod or None
        How the derivatives by the parameters were found.
    moved_start : tuple of str
        Parameters that change no output at the start that was given; `start` is another one.
    local : LinearizedProblem or None
        The problem made linear at the estimate, with the given noise variances or else the estimated ones. None where
        it was not kept in a file.
    noise : ResidualNoise or None
        The noise of all rows of the data, as the residual shows it. None where it was not kept in a file.
    history : History or None
        What `trace`, `rounds` and `fit` are made of, which are empty where it was not kept in a file.
    optima : tuple of Optimum
        Where the whole box was searched, from `fits` points: all that were found, the best first.
    fits : int or None
    accuracy : SolverCheck or None
        What the error of the simulation does to the estimates, part of `covariance`. None where it was not checked.
    data : tuple of MeasuredSeries
        Which measurements it was made from.
    attempts : tuple of RestartAttempt
        The starts that were tried, where the one that was given did not lead to a good end at once; empty where it did.
    units : mapping of str to str
        Of the parameters that have one.
    combinations : tuple of CombinationFit
        Of the values of parameters that take few: all that were tried, the best first, which the result is of.
    observer : float or None
        Time constant in samples of the observer whose predictions were fitted (`fmuid.identification.with_observer`).
    made_with : object
        What `predict` needs: a `fmuid.identification.ModelReference`, or the path of the file that this was read from.

    Examples
    --------
    >>> result = fmuid.identify(fmuid.datasets.coil().problem())
    >>> result["R"], result["R"].start
    (R = 3.9989 ± 0.0015 Ohm, 3.0)
    """

    outcome: TerminationReason
    names: tuple[str, ...]
    values: Floats
    start: Floats
    lower: Floats
    upper: Floats
    prior_mean: Floats
    prior_std: Floats
    covariance: Floats
    white_covariance: Floats
    freedom: Floats
    noise_variance: Mapping[str, float]
    given_variance: Mapping[str, float]
    criterion: float
    log_likelihood: float
    degrees_of_freedom: float
    iterations: int
    simulations: int
    elapsed_s: float
    undetermined: tuple[WeakDirection, ...]
    weak: tuple[WeakDirection, ...]
    prior_determined: tuple[WeakDirection, ...]
    at_bounds: tuple[ActiveBound, ...]
    version: str
    models: Mapping[str, UsedModel] = field(default_factory=dict)
    sensitivity: SensitivityMethod | None = None
    moved_start: tuple[str, ...] = ()
    local: LinearizedProblem | None = None
    noise: ResidualNoise | None = None
    history: History | None = None
    optima: tuple[Optimum, ...] = ()
    fits: int | None = None
    accuracy: SolverCheck | None = None
    data: tuple[MeasuredSeries, ...] = ()
    attempts: tuple[RestartAttempt, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    combinations: tuple[CombinationFit, ...] = ()
    observer: float | None = None
    made_with: object = field(default=None, repr=False)

    json_layout: ClassVar = codec.Layout(
        omitted={"local", "noise", "made_with"},
        derived=("converged",),
        rows={
            "parameters": {
                **{"value": "values", "std": "std", "white_std": "white_std", "degrees_of_freedom": "freedom"},
                **{"start": "start", "lower": "lower", "upper": "upper", "numerical_shift": "numerical_shift"},
                **{"prior_mean": "prior_mean", "prior_std": "prior_std", "pull": "pull", "unit": "units"},
            }
        },
        parts={"covariance": {"names": "names", "matrix": "covariance", "white": "white_covariance"}},
    )

    def __post_init__(self) -> None:
        count = len(self.names)
        if any(each.shape != (count, count) for each in (self.covariance, self.white_covariance)):
            raise ValueError(f"a covariance is not of {count} parameters")
        if any((np.diag(each) < 0).any() for each in (self.covariance, self.white_covariance)):
            raise ValueError("a variance is negative")

    @cached_property
    def trace(self) -> pd.DataFrame:
        """One row an iteration: round, iteration, criterion, lambda, accepted, and each parameter."""
        return pd.DataFrame() if self.history is None else self.history.trace_frame()

    @cached_property
    def rounds(self) -> pd.DataFrame:
        """One row a repetition of docs/method.md section 7.

        Columns round, iterations, criterion, and for each output the variance used (``used.``) and ``estimated.``.
        """
        return pd.DataFrame() if self.history is None else self.history.rounds_frame()

    @cached_property
    def fit(self) -> tuple[pd.DataFrame, ...]:
        """One table an experiment: time, and ``measured.<output>`` and ``simulated.<output>`` for each output."""
        return () if self.history is None else self.history.fit_frames()

    @property
    def chosen(self) -> dict[str, float | int | bool | str]:
        """The values of parameters that take few."""
        return dict(self.combinations[0].values) if self.combinations else {}

    @property
    def converged(self) -> bool:
        """Whether the search converged and every parameter is determined."""
        return self.outcome.converged

    def __repr__(self) -> str:
        pairs = zip(self.names, self.values.tolist(), self.std.tolist(), strict=True)
        told = [f"{name} = {with_std(value, std)}" for name, value, std in pairs]
        more = f", {len(told) - LINE_PARAMETERS} more" if len(told) > LINE_PARAMETERS else ""
        return f"Result({self.outcome.value}: {', '.join(told[:LINE_PARAMETERS])}{more})"

    def __str__(self) -> str:
        return str(self.summary())

    def summary(self) -> MultilineText:
        """Return the estimates as a table and what is to be said of them, in 25 lines at most, as `print` shows it."""
        return text_of(self)

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Return the estimate of one parameter: a number with its std, interval, unit, start and prior."""
        row = self.to_frame().iloc[self._index(name)].to_dict()
        known = {"name": name, "std": row["std"], "start": row["start"], "unit": self.units.get(name)}
        prior = None if math.isnan(row["prior_mean"]) else Normal(row["prior_mean"], row["prior_std"])
        return ParameterEstimate(row["value"], interval=(row["lower"], row["upper"]), prior=prior, **known)

    @property
    def std(self) -> Floats:
        """Standard deviations of the estimates (N,), infinite where not determined."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def white_std(self) -> Floats:
        """What the standard deviations would be if the noise were white (N,)."""
        return np.sqrt(np.diag(self.white_covariance))

    @property
    def widening(self) -> Floats:
        """By which factor the colour of the noise widens each standard deviation (N,); NaN where there is none."""
        known = np.isfinite(self.std) & np.isfinite(self.white_std) & (self.white_std > 0)
        return np.asarray(np.divide(self.std, self.white_std, out=np.full(len(self.names), np.nan), where=known))

    def quantiles(self, level: float) -> Floats:
        """Return how many standard deviations an interval reaches to each side of each estimate (N,), Student's t."""
        return self._student(np.full(len(self.names), 0.5 + level / 2.0))

    def reaches(self, level: float) -> Floats:
        """Return the same for intervals that are one-sided where the estimate stands on a bound."""
        held = [bound.name for bound in self.at_bounds]
        tail = np.where([name in held for name in self.names], max(level, 0.5), 0.5 + level / 2.0)
        return self._student(tail)

    def _student(self, tail: Floats) -> Floats:
        exact = np.isinf(self.freedom)
        student = special.stdtrit(np.where(exact, 1.0, self.freedom), tail)
        return np.asarray(np.where(exact, special.ndtri(tail), student), dtype=np.float64)

    def test_scale(self, names: Sequence[str]) -> float:
        """Return what the fall of the criterion by freeing parameters is divided by, for the colour of the noise.

        The largest eigenvalue of [H⁻¹]⁻¹V over these parameters, 1 for white noise: of the weighted sum of χ² variables
        that the fall is, a bound (Kent, "Robust properties of likelihood ratio tests", Biometrika 69, 1982). Those that
        are not determined are left out.
        """
        at = [i for i in map(self._index, names) if np.isfinite(self.std[i]) and np.isfinite(self.white_std[i])]
        if not at:
            return 1.0
        white, coloured = (each[np.ix_(at, at)] for each in (self.white_covariance, self.covariance))
        unit = np.outer(self.white_std[at], self.white_std[at])
        ratio = np.linalg.lstsq(white / unit, coloured / unit, rcond=None)[0]
        return float(np.max(np.linalg.eigvals(ratio).real))

    def test_freedom(self, names: Sequence[str]) -> float:
        """Return the degrees of freedom of a test of parameters: the harmonic mean of theirs."""
        inverse = float(np.mean(1.0 / self.freedom[[self._index(name) for name in names]]))
        return 1.0 / inverse if inverse > 0.0 else math.inf

    @property
    def pull(self) -> Floats:
        """How far each estimate lies from its prior mean, in prior standard deviations (N,); NaN without prior."""
        return (self.values - self.prior_mean) / self.prior_std

    @property
    def numerical_shift(self) -> Floats:
        """What a finer simulation would move each estimate by, in its standard deviations (N,); NaN: not known."""
        return np.full(len(self.names), np.nan) if self.accuracy is None else self.accuracy.shift

    @property
    def variance(self) -> dict[str, float]:
        """The noise variances that weigh the outputs: the given ones and, where there is none, the estimated ones."""
        return {**self.noise_variance, **self.given_variance}

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlation matrix of the estimates (N, N), NaN for those that are not determined."""
        std = np.where(np.isfinite(self.std) & (self.std > 0), self.std, np.nan)
        matrix = self.covariance / np.outer(std, std)
        return pd.DataFrame(matrix, index=list(self.names), columns=list(self.names))

    @property
    def strong_correlations(self) -> tuple[tuple[str, str, float], ...]:
        """Pairs of parameters whose correlation exceeds 0.95 in magnitude, the strongest first."""
        matrix = self.correlation.to_numpy()
        every = combinations(range(len(self.names)), 2)
        pairs = [(self.names[i], self.names[j], float(matrix[i, j])) for i, j in every]
        pairs = [pair for pair in pairs if abs(pair[2]) > STRONG_CORRELATION]
        return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))

    def intervals(self, level: float = 0.95) -> pd.DataFrame:
        """Return the confidence interval of each parameter, columns ``lower`` and ``upper``.

        With Student's t for the degrees of freedom of each standard deviation (`freedom`), with the normal
        distribution where they are infinite. It ends at bounds, and is one-sided where the estimate stands on one.
        An `InputError` says that the level is not between 0 and 1.
        """
        check_level(level)
        half = self.reaches(level) * self.std
        lower, upper = np.maximum(self.values - half, self.lower), np.minimum(self.values + half, self.upper)
        return pd.DataFrame({"lower": lower, "upper": upper}, index=list(self.names))

    def to_frame(self, level: float = 0.95) -> pd.DataFrame:
        """Return the parameters as a table, a row each by its name, with intervals of a level."""
        columns = {
            "value": self.values,
            "std": self.std,
            **self.intervals(level),
            "white_std": self.white_std,
            "numerical_shift": self.numerical_shift,
            "start": self.start,
            "prior_mean": self.prior_mean,
            "prior_std": self.prior_std,
            "pull": self.pull,
            "unit": [self.units.get(name, "") for name in self.names],
        }
        return pd.DataFrame(columns, index=pd.Index(self.names, name="parameter"))

    def made_from(self, experiment: Experiment) -> bool:
        """Return whether the measurements of an experiment are among those that this was made from."""
        return set(measured_series(experiment)) <= set(self.data)

    def after(self, earlier: Result) -> Result:
        """Return this result as one of a search that began with an earlier one, from where this one set out."""
        history = self.history and (self.history if earlier.history is None else self.history.after(earlier.history))
        total = earlier.iterations + self.iterations
        return replace(self, start=earlier.start, moved_start=earlier.moved_start, iterations=total, history=history)

    def prior(self, names: Sequence[str] | None = None, *, inflate: float = 1.0) -> JointPrior:
        """Return these estimates as a joint prior for another identification.

        A prior is normal: it has the standard deviations with which 95 % intervals are those of this result, also
        where these have few degrees of freedom.

        Parameters
        ----------
        names : sequence of str, optional
            Which parameters; default all.
        inflate : float
            Factor on the standard deviations, for variations to be expected (docs/method.md section 7).

        Raises
        ------
        InputError
            If a parameter is unknown or not determined here, or `inflate` is not positive.
        """
        chosen = list(self.names if names is None else names)
        where = [self._index(name) for name in chosen]
        for i in where:
            if not np.isfinite(self.std[i]):
                raise InputError(f"{self.names[i]!r} is not determined in this result and cannot serve as a prior")
        if not (math.isfinite(inflate) and inflate > 0):
            raise InputError(f"inflate must be greater than 0, not {inflate!r}")
        wider = inflate * self.quantiles(PRIOR_LEVEL)[where] / float(special.ndtri(0.5 + PRIOR_LEVEL / 2.0))
        covariance = self.covariance[np.ix_(where, where)] * np.outer(wider, wider)
        return JointPrior(chosen, self.values[where], covariance)

    def normal(self, name: str, *, inflate: float = 1.0) -> Normal:
        """Return the estimate of one parameter as a prior of its own, its correlations left out."""
        joint = self.prior([name], inflate=inflate)
        return Normal(float(joint.mean[0]), math.sqrt(float(joint.covariance[0, 0])))

    def to_json(self, path: str | Path) -> Path:
        """Write a ``result.json`` and return its path.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        return codec.write(Path(path), RESULT_SCHEMA, self)

    @classmethod
    def from_json(cls, path: str | Path) -> Result:
        """Read a ``result.json``; `local` and `noise`, which are not in it, are None, trace and fit are empty.

        An `InputError` says that it cannot be read or is not such a result.
        """
        path = Path(path)
        return replace(codec.read(path, RESULT_SCHEMA, cls, "run fmuid identify again"), made_with=path.resolve())

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise InputError(f"the result has no parameter {name!r}; it has {', '.join(self.names)}")
        return self.names.index(name)
