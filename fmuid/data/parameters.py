"""Parameters to estimate: initial guesses, bounds, scales."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Floats, Indices
from fmuid.data.priors import SMALLEST_MAGNITUDE, JointPrior, Normal, checked_number
from fmuid.errors import InputError, check_kind
from fmuid.formatting import nearest


@dataclass(frozen=True)
class Parameter:
    """Parameter to estimate.

    Parameters
    ----------
    start : float
        Initial guess, in the unit of the FMU variable.
    min, max : float
        Bounds, never exceeded by a simulation.
    nominal : float, optional
        Scale. Default: the magnitude of `start`; needed if that is zero.
    prior : Normal, optional
        Prior knowledge.
    per_experiment : bool or mapping of str to sequence of str
        One value per experiment (``name[experiment]``), or per named group of experiments (``name[group]``).

    Raises
    ------
    InputError
        If bounds are empty, exclude start or prior mean, or a zero start has no nominal.

    Examples
    --------
    >>> fmuid.Parameter(start=3.9, min=0.0, prior=fmuid.Normal(4.0, 0.1)).min
    0.0
    """

    start: float
    min: float = -math.inf
    max: float = math.inf
    nominal: float | None = None
    prior: Normal | None = None
    per_experiment: bool | Mapping[str, Sequence[str]] = False

    def name_in(self, experiment: str, name: str) -> str:
        """Return the name of parameter `name` in an experiment; exactly one group has it."""
        if isinstance(self.per_experiment, bool):
            return f"{name}[{experiment}]" if self.per_experiment else name
        groups = [group for group, members in self.per_experiment.items() if experiment in members]
        if len(groups) != 1:
            named = [member for members in self.per_experiment.values() for member in members]
            where = f"is in {' and '.join(groups) or 'none' + nearest(experiment, named)}"
            raise InputError(f"per_experiment of {name!r}: experiment {experiment!r} {where}. List each in one group.")
        return f"{name}[{groups[0]}]"

    def __post_init__(self) -> None:
        for word in ("start", "min", "max"):
            object.__setattr__(self, word, checked_number(getattr(self, word), word, infinite=word != "start"))
        if not self.min < self.max:
            said = f"min {self.min:g} must be less than max {self.max:g}"
            raise InputError(f"{said}. To fix the parameter, use [model.fixed].")
        if not self.min <= self.start <= self.max:
            raise InputError(f"start {self.start:g} is outside [{self.min:g}, {self.max:g}]. Change start, min or max.")
        if self.nominal is not None:
            object.__setattr__(self, "nominal", checked_number(self.nominal, "nominal"))
            if not self.nominal >= SMALLEST_MAGNITUDE:
                raise InputError(f"nominal must be greater than 0, not {self.nominal:g}.")
        elif abs(self.start) < SMALLEST_MAGNITUDE:
            raise InputError(f"start {self.start:g} gives no scale. Set nominal, the typical magnitude.")
        if self.prior is not None and not isinstance(self.prior, Normal):
            raise InputError(f"prior must be a Normal(mean, std), not {self.prior!r}.")
        if self.prior is not None and not self.min <= self.prior.mean <= self.max:
            said = f"mean {self.prior.mean:g} is outside [{self.min:g}, {self.max:g}]"
            raise InputError(f"prior: {said}. Change prior or bounds.")


class ParameterSet:
    """All parameters of a problem as one vector θ (N,).

    Parameters
    ----------
    parameters : mapping of str to Parameter
        By FMU variable.
    experiments : sequence of str
        Names of the experiments.
    joint_prior : JointPrior, optional
        Prior of several parameters.

    Attributes
    ----------
    names : tuple of str
        ``name``, or ``name[experiment]``.
    start, lower, upper, scale : (N,) arrays
        Initial guess, bounds, nominal magnitudes.
    prior_mean, prior_std : (N,) arrays
        NaN without a prior.
    prior_whitening : (q, N) array
        W of the prior rows W(θ₀ − θ) of (1.37).

    Raises
    ------
    InputError
        If there are no parameters, experiments share a name, or the joint prior does not fit.
    """

    def __init__(
        self,
        parameters: Mapping[str, Parameter],
        experiments: Sequence[str] = ("experiment",),
        joint_prior: JointPrior | None = None,
    ) -> None:
        check_kind(parameters, Mapping, "parameters must be a mapping of names to fmuid.Parameter(start)")
        check_kind(joint_prior, (JointPrior, type(None)), "joint_prior must be a fmuid.JointPrior")
        if not parameters:
            raise InputError("no free parameters. Give at least one, with its start.")
        for name, parameter in parameters.items():
            if not isinstance(parameter, Parameter):
                raise InputError(f"parameter {name!r} must be a Parameter(start=...), not {parameter!r}.")
        repeated = sorted({name for name in experiments if list(experiments).count(name) > 1})
        own = [name for name, parameter in parameters.items() if parameter.per_experiment]
        if own and repeated:
            said = f"two experiments are named {repeated[0]!r}, and {own[0]!r} has a value per experiment"
            raise InputError(f"{said}. Rename one experiment.")
        flat: dict[str, Parameter] = {}
        columns: list[list[int]] = [[] for _ in experiments]
        for name, parameter in parameters.items():
            for column, experiment in zip(columns, experiments, strict=True):
                full = parameter.name_in(experiment, name)
                flat.setdefault(full, parameter)
                column.append(list(flat).index(full))
        self._variables = tuple(parameters)
        self._columns = tuple(np.array(column, dtype=np.intp) for column in columns)
        self.names = tuple(flat)
        self.start = _frozen([p.start for p in flat.values()])
        self.lower = _frozen([p.min for p in flat.values()])
        self.upper = _frozen([p.max for p in flat.values()])
        self.scale = _frozen([p.nominal or abs(p.start) for p in flat.values()])
        self._least = _frozen([p.nominal or 1e-3 * abs(p.start) for p in flat.values()])  # steps must not vanish
        self._set_prior(flat, joint_prior)

    def __len__(self) -> int:
        return len(self.names)

    def for_experiment(self, index: int) -> tuple[tuple[str, ...], Indices]:
        """Return FMU variables of experiment `index`, and their places in θ."""
        return self._variables, self._columns[index]

    def within(self, lower: Floats, upper: Floats) -> ParameterSet:
        """Return these parameters within tighter bounds (N,)."""
        other = copy.copy(self)
        other.lower, other.upper = _frozen(np.maximum(self.lower, lower)), _frozen(np.minimum(self.upper, upper))
        return other

    def magnitudes(self, theta: Floats) -> Floats:
        """Return the scale at θ: |θ|, at least the nominal or 1/1000 of the start."""
        return np.maximum(np.abs(theta), self._least)

    def reach(self, theta: Floats) -> Floats:
        """Return the scale of difference steps: |θ|, at least nominal or start."""
        return np.maximum(np.abs(theta), self.scale)

    def index(self, name: str) -> int:
        """Return the index of `name` in θ; an `InputError` if it is unknown."""
        if name not in self.names:
            raise InputError(f"{name!r} is not a parameter of the problem{nearest(name, self.names)}.")
        return self.names.index(name)

    def _set_prior(self, flat: Mapping[str, Parameter], joint: JointPrior | None) -> None:
        count = len(flat)
        mean, std = np.full(count, np.nan), np.full(count, np.nan)
        rows = []
        for i, parameter in enumerate(flat.values()):
            if parameter.prior is not None:
                mean[i], std[i] = parameter.prior.mean, parameter.prior.std
                rows.append(np.where(np.arange(count) == i, 1.0 / std[i], 0.0))
        if joint is not None:
            where = [self.index(name) for name in joint.names]
            for i in where:
                if not np.isnan(mean[i]):
                    raise InputError(f"{self.names[i]!r} has its own prior and a joint prior. Keep one.")
            mean[where], std[where] = joint.mean, np.sqrt(np.diag(joint.covariance))
            for i in where:
                if not self.lower[i] <= mean[i] <= self.upper[i]:
                    said = f"of {self.names[i]!r} is outside [{self.lower[i]:g}, {self.upper[i]:g}]"
                    raise InputError(f"joint prior mean {mean[i]:g} {said}. Change prior or bounds.")
            block = np.zeros((len(where), count))
            block[:, where] = joint.whitening()
            rows.extend(block)
        self.prior_mean, self.prior_std = _frozen(mean), _frozen(std)
        self.prior_whitening = _frozen(np.array(rows).reshape(-1, count))

    def prior_residual(self, thetas: Floats) -> Floats:
        """Return the prior rows W(θ₀ − θ) of (1.37): (m, q) for thetas (m, N)."""
        away = np.where(np.isnan(self.prior_mean), 0.0, self.prior_mean - thetas)
        return np.asarray(away @ self.prior_whitening.T, dtype=np.float64)


def _frozen(values: ArrayLike) -> Floats:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
