"""Numbers of a change that stand alone: causes, sizes and odds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from scipy import special

from fmuid.array_types import Floats
from fmuid.diagnosis.baseline import BaselineSource
from fmuid.diagnosis.cause_ranking import CauseSet, nearest_cause
from fmuid.diagnosis.causes import Cause, CauseKind, ChangeParameterSet, name_of
from fmuid.diagnosis.change_detection import CauseFit, fit, probability
from fmuid.diagnosis.information_matrix import ScoreStatistics
from fmuid.diagnosis.noise_ratios import NoiseChange
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.diagnosis.unexplained_residual import UnexplainedResidual
from fmuid.estimation import check_level


@dataclass(frozen=True)
class EstimatedChange:
    """A cause and its size.

    Attributes
    ----------
    variable : str
        Parameter, fault parameter, output or input.
    fault : str
        Of a fault parameter, "" otherwise.
    value, std : float
        Of gains a share, of delays s; infinite std if not identifiable.
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
    std: float
    unit: str
    min: float = -math.inf
    max: float = math.inf
    angle: str = ""
    angle_value: float = math.nan
    angle_std: float = math.nan

    @property
    def label(self) -> str:
        """Name in tables: ``turns.dR``, ``gain(i)``, ``R``."""
        return name_of(self.kind, self.variable, self.fault)

    @property
    def is_determined(self) -> bool:
        """True if the record determines it beside all that may change."""
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
    """A cause alone as the explanation.

    Attributes
    ----------
    statistic : float
        D.
    probability : float
        By chance, of this cause by itself.
    rival : str
        Cause with the nearest signature, "" without others.
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
    odds : float
        Against the best explanation, at most 1.
    """

    changes: tuple[EstimatedChange, ...]
    odds: float

    @property
    def faults(self) -> tuple[str, ...]:
        """Faults among them."""
        return tuple(dict.fromkeys(each.fault for each in self.changes if each.fault))


@dataclass(frozen=True)
class ChangeEvidence:
    """Evidence of changes in a record.

    Attributes
    ----------
    probability : float
        Of the likeliest cause by chance, for all causes.
    alarm : bool
        It is below the level.
    explanations : tuple of Explanation
        Best first, then all that are not excluded.
    suspects : tuple of CauseScore
        Every cause alone.
    model_error : float
        κ, stated or measured.
    temper : float
        Divisor of evidence after the alarm, for the models' error.
    ratio, without : float
        Variance of the residual over the noise, with the best explanation and without any.
    steady : bool
        The name stayed in the last linearisation.
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
        """Explained share of the change; 0 without an alarm."""
        if not self.alarm:
            return 0.0
        if self.basis.alone:
            return min(1.0, max(0.0, (self.without - self.ratio) / (self.without - 1.0))) if self.without > 1 else 0.0
        statistic = max(each.statistic for each in self.suspects) / self.temper
        rest = max(0.0, self.remainder.statistic - self.remainder.degrees)
        return statistic / (statistic + rest) if statistic > 0 else 0.0

    def with_noise(self, each: Mapping[str, NoiseChange], louder: Mapping[str, bool], share: float) -> ChangeEvidence:
        """Return the evidence with the noise of each output as a cause.

        `louder` are outputs with more noise than healthy records have. Without color it is that of the sensor, else
        unexplained. `share` is that of the level for each output.
        """
        scores = {output: _noise_score(output, change) for output, change in each.items()}
        chances = {output: min(1.0, scores[output].probability / share) for output in louder}
        sensors = [output for output, is_white in louder.items() if is_white]
        noisy, rest = tuple(scores[output].change for output in sensors), self.remainder
        for output in (name for name, is_white in louder.items() if not is_white):
            chance = UNEXPLAINED_RESIDUAL.structure_share * chances[output]
            rest = min(
                rest, UnexplainedResidual(scores[output].statistic, 1, chance, output), key=attrgetter("probability")
            )
        with_noise = [replace(one, changes=(*one.changes, *noisy)) for one in self.explanations]
        return replace(
            self,
            probability=min([self.probability, *(chances[output] for output in sensors)]),
            alarm=self.alarm or bool(noisy),
            explanations=tuple(with_noise) or ((Explanation(noisy, 1.0),) if noisy else ()),
            suspects=(*self.suspects, *scores.values()),
            remainder=rest,
        )

    @property
    def faults(self) -> tuple[str, ...]:
        """Named faults, the most likely first."""
        return tuple(dict.fromkeys(name for each in self.explanations for name in each.faults))


def _noise_score(output: str, change: NoiseChange) -> CauseScore:
    """Return the noise of an output as a cause."""
    value, std = change.size
    size = EstimatedChange(CauseKind.NOISE, output, "", value, std, "", -1.0)
    return CauseScore(size, change.statistic, change.probability, "", math.nan)


def explanations(named: Sequence[CauseSet], coordinates: ChangeParameterSet) -> tuple[Explanation, ...]:
    """Return named causes with their sizes and odds."""
    return tuple(Explanation(changes(each.causes, each.fit, coordinates), each.odds) for each in named)


def changes(causes: Sequence[Cause], found: CauseFit, coordinates: ChangeParameterSet) -> tuple[EstimatedChange, ...]:
    """Return causes with their sizes; a vector of the plane becomes a size with its angle."""
    said, first = list[EstimatedChange](), 0
    for cause in causes:
        at = slice(first, first + len(cause.columns))
        first = at.stop
        said.append(_change(coordinates, cause, found.sizes[at], found.covariance[at, at]))
    return tuple(said)


def _change(coordinates: ChangeParameterSet, cause: Cause, size: Floats, covariance: Floats) -> EstimatedChange:
    of = coordinates.each[cause.columns[0]]
    what = of.kind, of.variable, of.fault_name
    if len(size) == 1:
        std, limits = math.sqrt(float(covariance[0, 0])), coordinates.limits(of)
        return EstimatedChange(*what, float(size[0]), std, of.unit, *limits)
    length = float(np.hypot(*size))
    along = size / length if length else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    std, aside = (math.sqrt(float(each @ covariance @ each)) for each in (along, across))
    name, value, turn = coordinates.faults[of.fault].direction(of.variable, size.tolist())
    off = turn * aside / length if length else math.inf
    return EstimatedChange(*what, length, std, of.unit, 0.0, math.inf, name, value, off)


def score(
    cause: Cause, news: ScoreStatistics, determined: Sequence[Cause], coordinates: ChangeParameterSet
) -> CauseScore:
    """Return a cause alone, beside the other causes that the records determine."""
    if cause not in determined:
        at = coordinates.each[cause.columns[0]]
        return CauseScore(
            EstimatedChange(at.kind, at.variable, at.fault_name, 0.0, math.inf, at.unit), 0.0, 1.0, "", math.nan
        )
    alone = fit(news, (cause,))
    (change,) = changes((cause,), alone, coordinates)
    near = nearest_cause(news, cause, [other for other in determined if other is not cause])
    return CauseScore(change, alone.statistic, probability(alone.statistic, cause, news), *near)
