"""What is new in a record, in numbers that stand alone: causes, their sizes, and the odds between them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator
from scipy import special

from fmuid.diagnosis.baseline import BaselineSource
from fmuid.diagnosis.cause_analysis import Examination
from fmuid.diagnosis.cause_ranking import angle
from fmuid.diagnosis.causes import Cause, CauseKind, ChangeParameterSet, name_of
from fmuid.diagnosis.change_detection import CauseFit, fit, probability
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.unexplained_residual import UnexplainedResidual
from fmuid.estimation import check_level


def _instead(missing: float) -> BeforeValidator:
    """Return what stands for None in a file, where numbers that are not finite are None."""
    return BeforeValidator(lambda value: missing if value is None else value)


Unknown = Annotated[float, _instead(math.nan)]
Unlimited = Annotated[float, _instead(math.inf)]
Unbounded = Annotated[float, _instead(-math.inf)]


@dataclass(frozen=True)
class EstimatedChange:
    """A cause and its size.

    Attributes
    ----------
    kind : CauseKind
    variable : str
        Parameter, fault parameter, output or input.
    fault : str
        The fault of a fault parameter, "" otherwise.
    value, std : float
        Of gains a share, of delays s; the standard deviation is infinite where the record does not determine it.
    unit : str
        "" without.
    min, max : float
        Bounds.
    angle : str
        The parameter that locates a fault, "" without.
    angle_value, angle_std : float
        NaN without.
    """

    kind: CauseKind
    variable: str
    fault: str
    value: float
    std: Unlimited
    unit: str
    min: Unbounded = -math.inf
    max: Unlimited = math.inf
    angle: str = ""
    angle_value: Unknown = math.nan
    angle_std: Unknown = math.nan

    @property
    def label(self) -> str:
        """What it is called in tables: ``turns.dR``, ``gain(i)``, ``R``."""
        return name_of(self.kind, self.variable, self.fault)

    @property
    def is_determined(self) -> bool:
        """Whether the record determines it beside all that may change."""
        return math.isfinite(self.std)

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval, cut at the bounds.

        Raises
        ------
        InputError
            If the level is not between 0 and 1.
        """
        check_level(level)
        half = float(special.ndtri(0.5 + level / 2.0)) * self.std
        return max(self.value - half, self.min), min(self.value + half, self.max)


@dataclass(frozen=True)
class CauseScore:
    """A cause alone, as it explains the record.

    Attributes
    ----------
    change : EstimatedChange
        At the healthy machine, or where the models were linearised last.
    statistic : float
        D.
    probability : float
        That chance explains as much, of this cause by itself.
    rival : str
        The cause whose signature is nearest, "" without others.
    rival_angle : float
        Between the two signatures, rad.
    """

    change: EstimatedChange
    statistic: float
    probability: float
    rival: str
    rival_angle: Unknown


@dataclass(frozen=True)
class Explanation:
    """One or two changes that explain the record.

    Attributes
    ----------
    changes : tuple of EstimatedChange
    odds : float
        Against the best explanation, at most 1.
    """

    changes: tuple[EstimatedChange, ...]
    odds: float

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults among them."""
        return tuple(dict.fromkeys(each.fault for each in self.changes if each.fault))


@dataclass(frozen=True)
class ChangeEvidence:
    """What is new in a record.

    Attributes
    ----------
    probability : float
        That chance makes any cause as likely where nothing is new.
    alarm : bool
        Whether that is below the level.
    explanations : tuple of Explanation
        The best one first, then all that the record does not exclude beside it.
    suspects : tuple of CauseScore
        Every cause alone.
    model_error : float
        κ, stated or measured on trials.
    temper : float
        By which evidence is divided after the alarm, for the models' own error.
    ratio, without : float
        Variance of the residual over the noise, with the best explanation and without any.
    samples : int
    steady : bool
        Whether the name stayed when the models were linearised there.
    remainder : UnexplainedResidual
        What no cause explains beside healthy records.
    basis : BaselineSource
        Where the healthy machine is from.
    """

    probability: float
    alarm: bool
    explanations: tuple[Explanation, ...]
    suspects: tuple[CauseScore, ...]
    model_error: float
    temper: float
    ratio: float
    without: float
    samples: int
    steady: bool
    remainder: UnexplainedResidual
    basis: BaselineSource = BaselineSource.RECORDS

    @property
    def explained(self) -> float:
        """How much of what is new the best explanation explains, a share; 0 without an alarm."""
        if not self.alarm:
            return 0.0
        if self.basis is BaselineSource.RESULT:
            return min(1.0, max(0.0, (self.without - self.ratio) / (self.without - 1.0))) if self.without > 1 else 0.0
        statistic = max(each.statistic for each in self.suspects) / self.temper
        rest = max(0.0, self.remainder.statistic - self.remainder.degrees)
        return statistic / (statistic + rest) if statistic > 0 else 0.0

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults named, the most likely first."""
        return tuple(dict.fromkeys(name for each in self.explanations for name in each.faults))

    @classmethod
    def of(cls, found: Examination, faults: Mapping[str, Fault], basis: BaselineSource) -> ChangeEvidence:
        """Return the numbers of an examination."""
        naming, coordinates = found.naming, found.coordinates
        return cls(
            naming.probability,
            naming.alarm,
            tuple(Explanation(changes(each.causes, each.fit, coordinates, faults), each.odds) for each in naming.named),
            tuple(_suspect(found, cause, faults) for cause in coordinates.causes),
            found.model_error,
            naming.temper,
            found.ratio,
            found.without,
            found.samples,
            found.steady,
            found.remainder,
            basis,
        )


def changes(
    causes: Sequence[Cause], found: CauseFit, coordinates: ChangeParameterSet, faults: Mapping[str, Fault]
) -> tuple[EstimatedChange, ...]:
    """Return causes with their sizes; a vector of the plane is a size with its angle."""
    said, first = [], 0
    for cause in causes:
        at = slice(first, first + len(cause.columns))
        first = at.stop
        size, covariance, of = found.sizes[at], found.covariance[at, at], coordinates.each[cause.columns[0]]
        if len(size) == 1:
            change = EstimatedChange(
                of.kind, of.variable, of.fault, float(size[0]), math.sqrt(float(covariance[0, 0])), of.unit
            )
            if of.fault:
                parameter = faults[of.fault].parameters[of.variable]
                change = replace(change, min=parameter.min, max=parameter.max)
            said.append(change)
            continue
        length = float(np.hypot(*size))
        along = size / length if length else np.array([1.0, 0.0])
        across = np.array([-along[1], along[0]])
        std, aside = (math.sqrt(float(each @ covariance @ each)) for each in (along, across))
        name, value, turn = faults[of.fault].direction(of.variable, size.tolist())
        off = turn * aside / length if length else math.inf
        change = EstimatedChange(of.kind, of.variable, of.fault, length, std, of.unit, min=0.0)
        said.append(replace(change, angle=name, angle_value=value, angle_std=off))
    return tuple(said)


def _suspect(found: Examination, cause: Cause, faults: Mapping[str, Fault]) -> CauseScore:
    if cause not in found.at.causes:
        at, none = found.coordinates.each[cause.columns[0]], math.inf
        return CauseScore(EstimatedChange(at.kind, at.variable, at.fault, 0.0, none, at.unit), 0.0, 1.0, "", math.nan)
    alone = fit(found.at.news, (cause,))
    change = changes((cause,), alone, found.coordinates, faults)[0]
    near = {other.name: angle(found.at.news, cause, other) for other in found.at.causes if other is not cause}
    rival = min(near, key=lambda each: near[each], default="")
    return CauseScore(change, alone.statistic, probability(alone.statistic, cause), rival, near.get(rival, math.nan))
