"""The result of an identification."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from scipy import special

from fmuid import codec
from fmuid.array_types import Floats
from fmuid.data import Experiment, JointPrior, Normal, measured_series
from fmuid.display_mixins import MultilineText, PlotMixin, text_of
from fmuid.errors import InputError
from fmuid.estimation.estimates import Estimates, ParameterEstimate
from fmuid.estimation.result_groups import Fit, History, Identifiability, Setup
from fmuid.estimation.search.state import TerminationReason
from fmuid.estimation.solver_check import SolverCheck
from fmuid.estimation.verdict import Verdict
from fmuid.formatting import with_std

# Level of the intervals that an estimate keeps when it becomes a prior.
PRIOR_LEVEL = 0.95
RESULT_SCHEMA = "fmuid/result/2"


@dataclass(frozen=True, eq=False)
class Result(PlotMixin):
    """Result of an identification.

    Attributes
    ----------
    outcome : TerminationReason
    estimates : Estimates
    fit : Fit
    identifiability : Identifiability
    history : History
    setup : Setup
    accuracy : SolverCheck or None
        Effect of the solver error on the estimates, included in `covariance`; None if it was not checked.
    verdict : Verdict or None
        Grade and reasons (`fmuid.identification.judge`); None before that.

    Examples
    --------
    >>> result = fmuid.identify(fmuid.datasets.coil().problem())
    >>> result["R"], result["R"].start
    (R = 3.9985 ± 0.0016 Ohm, 3.0)
    """

    outcome: TerminationReason
    estimates: Estimates
    fit: Fit
    identifiability: Identifiability
    history: History
    setup: Setup
    accuracy: SolverCheck | None = None
    verdict: Verdict | None = None

    json_layout: ClassVar = codec.Layout(inlined={"estimates"}, derived=("converged",))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.estimates.names

    @property
    def values(self) -> Floats:
        """Estimated values (N,)."""
        return self.estimates.values

    @property
    def std(self) -> Floats:
        """Standard deviations (N,); infinite if not identifiable."""
        return self.estimates.std

    @property
    def covariance(self) -> Floats:
        """Covariance (N, N) of the estimates."""
        return self.estimates.covariance

    @property
    def solver_error(self) -> Floats:
        """Shift of each estimate by a finer simulation in standard deviations (N,); NaN if unknown."""
        return np.full(len(self.names), np.nan) if self.accuracy is None else self.accuracy.shift

    @property
    def chosen(self) -> dict[str, float | int | bool | str]:
        """Values of the discrete parameters."""
        return dict(self.history.combinations[0].values) if self.history.combinations else {}

    @property
    def converged(self) -> bool:
        """Whether the search converged and every parameter is identifiable."""
        return self.outcome.converged

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Return the estimate of one parameter: a number with its std, interval, unit, start and prior."""
        return self.estimates.estimate(name)

    def __repr__(self) -> str:
        pairs = zip(self.names, self.values.tolist(), self.std.tolist(), strict=True)
        told = [f"{name} = {with_std(value, std)}" for name, value, std in pairs]
        more = f", {len(told) - 8} more" if len(told) > 8 else ""  # one line
        return f"Result({self.outcome.value}: {', '.join(told[:8])}{more})"

    def __str__(self) -> str:
        return str(self.summary())

    def summary(self) -> MultilineText:
        """Return the estimates and messages as at most 25 lines of text."""
        return text_of(self)

    def intervals(self, level: float = 0.95) -> pd.DataFrame:
        """Return confidence intervals of the parameters, columns ``lower`` and ``upper``.

        Student's t with the degrees of freedom of each variance. Intervals end at bounds, and are one-sided for
        estimates at a bound.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        return self.estimates.intervals(level)

    def to_frame(self, level: float = 0.95) -> pd.DataFrame:
        """Return the estimates with intervals, one row per parameter."""
        found = self.estimates
        columns = {
            "value": found.values,
            "std": found.std,
            **found.intervals(level),
            "std_white_noise": found.std_white_noise,
            "solver_error": self.solver_error,
            "start": found.start,
            "prior_mean": found.prior_mean,
            "prior_std": found.prior_std,
            "prior_z_score": found.prior_z_score,
            "unit": [found.units.get(name, "") for name in found.names],
        }
        return pd.DataFrame(columns, index=pd.Index(found.names, name="parameter"))

    @cached_property
    def trace(self) -> pd.DataFrame:
        """One row per iteration: round, iteration, cost, damping, accepted, and each parameter."""
        steps = [step for _, step in self.history.trace]
        columns: dict[str, object] = {
            "round": [number for number, _ in self.history.trace],
            "iteration": [step.number for step in steps],
            "cost": [step.criterion for step in steps],
            "damping": [step.damping for step in steps],
            "accepted": [step.accepted for step in steps],
        }
        thetas = np.array([step.theta for step in steps]).reshape(-1, len(self.names))
        return pd.DataFrame(columns | dict(zip(self.names, thetas.T, strict=True)))

    def made_from(self, experiment: Experiment) -> bool:
        """Return True if this result used the measurements of an experiment."""
        return set(measured_series(experiment)) <= set(self.setup.data)

    def after(self, earlier: Result) -> Result:
        """Return this result as the continuation of an earlier search."""
        return replace(
            self,
            estimates=replace(self.estimates, start=earlier.estimates.start),
            identifiability=replace(
                self.identifiability, replaced_initial_guess=earlier.identifiability.replaced_initial_guess
            ),
            history=self.history.after(earlier.history),
        )

    def prior(self, names: Sequence[str] | None = None, *, inflate: float = 1.0) -> JointPrior:
        """Return the estimates as a joint prior for another identification.

        The normal prior has the 95 % intervals of this result, also with few degrees of freedom.

        Parameters
        ----------
        names : sequence of str, optional
            Default: all parameters.
        inflate : float
            Factor on the standard deviations (docs/method/noise-variances.md).

        Raises
        ------
        InputError
            If a parameter is unknown or not identifiable, or `inflate` is not positive.
        """
        found = self.estimates
        chosen = list(found.names if names is None else names)
        where = [found.index(name) for name in chosen]
        known = np.isfinite(found.std)
        for i in where:
            if not known[i]:
                raise InputError(f"{found.names[i]!r} is not identifiable in this result and cannot be a prior")
        if not (math.isfinite(inflate) and inflate > 0):
            raise InputError(f"inflate must be greater than 0, not {inflate!r}")
        wider = inflate * found.quantiles(PRIOR_LEVEL)[where] / float(special.ndtri(0.5 + PRIOR_LEVEL / 2.0))
        return JointPrior(chosen, found.values[where], found.covariance[np.ix_(where, where)] * np.outer(wider, wider))

    def normal(self, name: str, *, inflate: float = 1.0) -> Normal:
        """Return one estimate as a prior, without its correlations; arguments and errors as for `prior`."""
        joint = self.prior([name], inflate=inflate)
        return Normal(float(joint.mean[0]), math.sqrt(float(joint.covariance[0, 0])))

    def to_json(self, path: str | Path) -> Path:
        """Write a ``result.json`` and return its path; `InputError` if that fails."""
        return codec.write(Path(path), RESULT_SCHEMA, self)

    @classmethod
    def from_json(cls, path: str | Path) -> Result:
        """Read a ``result.json``, without trace, linearization, noise model and outputs.

        Raises
        ------
        InputError
            If it cannot be read or is no result.
        """
        path, remedy = Path(path), "run fmuid identify again"
        found = codec.read(path, RESULT_SCHEMA, cls, remedy).located(path)
        if found.solver_error.shape != found.values.shape:
            raise InputError(f"{path} cannot be right: accuracy.shift has not one value per parameter; {remedy}")
        return found

    def located(self, path: Path) -> Result:
        """Return this result as one read from a file."""
        return replace(self, setup=replace(self.setup, made_with=path.resolve()))
