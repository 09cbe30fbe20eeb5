"""What is new in a record, in numbers that stand alone: causes, their sizes, and the odds between them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from fmuid.diagnosis.baseline.stored_baseline import BaselineSource
from fmuid.diagnosis.cause_analysis import Examination
from fmuid.diagnosis.change_detection.cause_ranking import angle
from fmuid.diagnosis.change_detection.causes import Cause
from fmuid.diagnosis.change_detection.detection import CauseFit, fit, probability
from fmuid.diagnosis.change_detection.unexplained_residual import UnexplainedResidual
from fmuid.diagnosis.change_parameters import CauseKind, ChangeParameter, ChangeParameterSet, name_of
from fmuid.diagnosis.faults import Fault


@dataclass(frozen=True)
class EstimatedChange:
    """A cause and its size.

    Attributes
    ----------
    kind : CauseKind
    variable : str
        Parameter, fault parameter, output or input.
    fault : str
        The hypothesis of a fault parameter, "" otherwise.
    value, std : float
        Of gains a share, of delays s.
    unit : str
        "" without.
    angle : str
        The parameter that locates a fault, "" without.
    angle_value : float
        NaN without.
    """

    kind: CauseKind
    variable: str
    fault: str
    value: float
    std: float
    unit: str
    angle: str = ""
    angle_value: float = math.nan

    @property
    def label(self) -> str:
        """What it is called in tables: ``turns.dR``, ``gain(i)``, ``R``."""
        return name_of(self.kind, self.variable, self.fault)

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval; of a size with an angle from 0 on."""
        half = float(special.ndtri(0.5 + level / 2.0)) * self.std
        low = self.value - half
        return (max(0.0, low) if self.angle else low), self.value + half


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
    rival_angle: float


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

    @classmethod
    def of_json(cls, data: Mapping[str, Any]) -> Explanation:
        """Return that of a file."""
        return cls(tuple(_change(each) for each in data["changes"]), float(data["odds"]))

    @property
    def faults(self) -> tuple[str, ...]:
        """The hypotheses among them."""
        return tuple(dict.fromkeys(each.fault for each in self.changes if each.fault))


@dataclass(frozen=True)
class ChangeEvidence:
    """What is new in a record beside the healthy ones.

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
        What no cause explains.
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
        statistic = max(each.statistic for each in self.suspects) / self.temper if self.alarm else 0.0
        rest = max(0.0, self.remainder.statistic - self.remainder.degrees)
        return statistic / (statistic + rest) if statistic > 0 else 0.0

    @property
    def faults(self) -> tuple[str, ...]:
        """The hypotheses named, the most likely first."""
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

    @classmethod
    def of_json(cls, data: Mapping[str, Any]) -> ChangeEvidence:
        """Return that of a file.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the data are not of one.
        """
        plain = {
            key: data[key]
            for key in ("probability", "alarm", "model_error", "temper", "ratio", "without", "samples", "steady")
        }
        explanations = tuple(map(Explanation.of_json, data["explanations"]))
        suspects = tuple(CauseScore(**each | {"change": _change(each["change"])}) for each in data["suspects"])
        remainder = UnexplainedResidual(**data["remainder"])
        basis = BaselineSource(data["basis"])
        return cls(explanations=explanations, suspects=suspects, remainder=remainder, basis=basis, **plain)


def _change(data: Mapping[str, Any]) -> EstimatedChange:
    angle_value = math.nan if data["angle_value"] is None else float(data["angle_value"])
    std = math.inf if data["std"] is None else float(data["std"])
    return EstimatedChange(**{**data, "kind": CauseKind(data["kind"]), "angle_value": angle_value, "std": std})


def changes(
    causes: Sequence[Cause], found: CauseFit, coordinates: ChangeParameterSet, faults: Mapping[str, Fault]
) -> tuple[EstimatedChange, ...]:
    """Return causes with their sizes; a vector of the plane is a size with its angle."""
    said, first = [], 0
    for cause in causes:
        count = len(cause.columns)
        size = found.sizes[first : first + count]
        covariance = found.covariance[first : first + count, first : first + count]
        first += count
        coordinate = coordinates.each[cause.columns[0]]
        if count == 1:
            said.append(_plain(coordinate, float(size[0]), math.sqrt(float(covariance[0, 0]))))
            continue
        length = float(np.hypot(*size))
        along = size / length if length else np.array([1.0, 0.0])
        said.append(
            _plain(
                coordinate,
                length,
                math.sqrt(float(along @ covariance @ along)),
                *faults[coordinate.fault].direction(coordinate.variable, size.tolist()),
            )
        )
    return tuple(said)


def _plain(
    of: ChangeParameter, value: float, std: float, angle_name: str = "", angle_value: float = math.nan
) -> EstimatedChange:
    return EstimatedChange(of.kind, of.variable, of.fault, value, std, of.unit, angle_name, angle_value)


def _suspect(found: Examination, cause: Cause, faults: Mapping[str, Fault]) -> CauseScore:
    alone = fit(found.news, (cause,))
    change = changes((cause,), alone, found.coordinates, faults)[0]
    near = {other.name: angle(found.news, cause, other) for other in found.coordinates.causes if other is not cause}
    rival = min(near, key=lambda each: near[each], default="")
    return CauseScore(change, alone.statistic, probability(alone.statistic, cause), rival, near.get(rival, math.nan))
