"""What is new in a record beside the healthy machine: all causes by their signatures, linearised where they are.

The healthy records say what the machine, its sensors and its supply are like, with the joint covariance of all of it;
drifts that are no fault widen it; what the new record says beyond that is tested at the level asked for; and the causes
are weighed against each other. D at the healthy machine is too small for large faults, or their name wrong: the models
are linearised again at the cause named until the name stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.diagnosis.baseline.stored_baseline import StoredBaseline
from fmuid.diagnosis.baseline.whitening import Whitening
from fmuid.diagnosis.change_detection.cause_ranking import MODEL_ERROR, CauseRanking, name
from fmuid.diagnosis.change_detection.causes import Cause
from fmuid.diagnosis.change_detection.detection import MinPDistribution, fit
from fmuid.diagnosis.change_detection.information_matrix import ChangePrior, InformationMatrix, ScoreStatistics
from fmuid.diagnosis.change_detection.unexplained_residual import (
    NOTHING_LEFT,
    UnexplainedResidual,
    change,
    lagged,
    probability,
    regression,
)
from fmuid.diagnosis.change_parameters import ChangeParameterSet
from fmuid.diagnosis.linearisation import LinearizedMachine
from fmuid.errors import SimulationError

# The null estimate and the name are found again at most so often; a name that alternates ends there too.
NULL_STEPS, NAME_STEPS = 2, 4
# Sizes that move by less, in standard deviations, have settled.
SETTLED = 0.1
# The largest error seen in trials over κ: three standard deviations.
TOLERATED = 3.0


@dataclass(frozen=True, eq=False)
class Examination:
    """What a record says of all causes.

    Attributes
    ----------
    coordinates : ChangeParameterSet
    naming : CauseRanking
        Sizes in the order of each explanation's coordinates.
    news : ScoreStatistics
        At the point where the models were linearised last.
    point : (N,) array
        That point.
    model_error : float
        κ by which it was named.
    ratio : float
        Of the residual's variance and the noise, with what was named.
    without : float
        The same without anything new.
    samples : int
    steady : bool
        Whether the name stayed when the models were linearised again.
    remainder : UnexplainedResidual
        What no cause explains.
    """

    coordinates: ChangeParameterSet
    naming: CauseRanking
    news: ScoreStatistics
    point: Floats
    model_error: float
    ratio: float
    without: float
    samples: int
    steady: bool = True
    remainder: UnexplainedResidual = NOTHING_LEFT


@dataclass(frozen=True, eq=False)
class BaselineStatistics:
    """What the healthy machine is like, as new records are compared with it.

    Attributes
    ----------
    known : ChangePrior
        Of all coordinates, relative to the healthy ones.
    whitening : Whitening
    drift : (N,) array
        Standard deviation of what may change without being a fault.
    owed : InformationMatrix or None
        What the residuals of the healthy records owe to the inputs; None without records.
    """

    known: ChangePrior
    whitening: Whitening
    drift: Floats
    owed: InformationMatrix | None = None


def shown_by(
    records: Sequence[LinearizedMachine], whitening: Whitening, coordinates: ChangeParameterSet
) -> StoredBaseline:
    """Return what healthy records showed.

    Parameters
    ----------
    records : sequence of LinearizedMachine
        Over at least one healthy record.
    whitening : Whitening
    coordinates : ChangeParameterSet

    Raises
    ------
    SimulationError
        If the healthy machine cannot be simulated.
    """
    said = [_information(machine, whitening, coordinates.healthy, coordinates.healthy) for machine in records]
    return StoredBaseline(tuple(said), _owed(records, whitening, coordinates.healthy), whitening)


def healthy_of(shown: StoredBaseline, coordinates: ChangeParameterSet, drift: Floats) -> BaselineStatistics:
    """Return what healthy records leave known; `drift` (N,) as the class has it."""
    return BaselineStatistics(
        ChangePrior.after_several(shown.said, coordinates.normal), shown.whitening, drift, shown.owed
    )


def examine(
    machines: Sequence[LinearizedMachine],
    healthy: BaselineStatistics,
    coordinates: ChangeParameterSet,
    level: float,
    model_error: float = MODEL_ERROR,
) -> Examination:
    """Say what is new in records of one machine.

    Parameters
    ----------
    machines : sequence of LinearizedMachine
        Over the new records.
    healthy : BaselineStatistics
    coordinates : ChangeParameterSet
    level : float
        Probability of an alarm where nothing is new.
    model_error : float
        κ (`fmuid.diagnosis.change_detection.cause_ranking`).

    Raises
    ------
    SimulationError
        If the healthy machine cannot be simulated.
    """
    work = _CauseAnalyzer(machines, healthy, coordinates, level, model_error)
    point = coordinates.healthy
    said = work.at(point)
    for _ in range(NULL_STEPS):
        point = coordinates.healthy + work.null(ScoreStatistics.of(said, work.known))
        said = work.at(point)
    without, samples = work.variance(point)
    news = ScoreStatistics.of(said, work.known)
    chance = MinPDistribution.of(news, coordinates.causes)
    naming = work.named(news, chance)
    found = Examination(coordinates, naming, news, point, model_error, without, without, samples)
    found = work.settled(found, chance) if naming.named else found
    return replace(found, remainder=work.remainder(found))


def error_of(
    trial: LinearizedMachine, healthy: BaselineStatistics, coordinates: ChangeParameterSet, cause: Cause, level: float
) -> float:
    """Return κ of a trial: how much of a fault's effect its model leaves along another cause's signature.

    A third of the largest √(D₂|₁/D₁), what chance adds on the average taken off: pairs are named from about 4 κ on.

    Parameters
    ----------
    trial : LinearizedMachine
        Over a record in which this cause is there, and nothing else is new.
    healthy : BaselineStatistics
    coordinates : ChangeParameterSet
    cause : Cause
    level : float
        As for `examine`; a trial that shows nothing new says nothing.

    Returns
    -------
    float
        NaN where the trial shows nothing new.
    """
    found = examine([trial], healthy, replace(coordinates, causes=(cause,)), level, model_error=0.0)
    if not found.naming.alarm:
        return math.nan
    plain, own = replace(cause, sign=0), fit(found.news, (cause,)).statistic
    others = [replace(each, sign=0) for each in coordinates.causes if each is not cause]
    left = [fit(found.news, (plain, other)).statistic - own - len(other.columns) for other in others]
    return math.sqrt(max(0.0, *left) / own) / TOLERATED if left else 0.0


class _CauseAnalyzer:
    """What all steps of an examination share."""

    def __init__(
        self,
        machines: Sequence[LinearizedMachine],
        healthy: BaselineStatistics,
        coordinates: ChangeParameterSet,
        level: float,
        model_error: float,
    ) -> None:
        self.machines, self.healthy, self.coordinates = machines, healthy, coordinates
        self.level, self.model_error = level, model_error
        self.known = healthy.known.drifting(healthy.drift)

    def at(self, point: Floats) -> InformationMatrix:
        """Return what the records say, linearised at a point (N,)."""
        first, *others = (
            _information(machine, self.healthy.whitening, point, self.coordinates.healthy) for machine in self.machines
        )
        for each in others:
            first = first + each
        return first

    def null(self, news: ScoreStatistics, new: Floats | None = None) -> Floats:
        """Return the estimate of everything beside what is new (N,), relative to the healthy machine."""
        score = news.score if new is None else news.score - news.information @ new
        return np.asarray(self.known.mean + self.known.covariance @ score)

    def named(self, news: ScoreStatistics, chance: MinPDistribution) -> CauseRanking:
        """Return what is new."""
        return name(news, self.coordinates.causes, self.level, chance=chance, model_error=self.model_error)

    def variance(self, point: Floats) -> tuple[float, int]:
        """Return the variance of the whitened residual at a point, and the number of samples."""
        squares, samples = 0.0, 0
        for machine in self.machines:
            outputs = machine.outputs(point)
            white = self.healthy.whitening(machine.experiment, _residual(machine.experiment, outputs)[:, :, None])
            squares, samples = squares + float(np.sum(white**2)), samples + white.size
        return squares / samples, samples

    def remainder(self, found: Examination) -> UnexplainedResidual:
        """Return the change of what the residual owes to the inputs, beside all causes and the models' error."""
        if self.healthy.owed is None:
            return NOTHING_LEFT
        owed = _owed(self.machines, self.healthy.whitening, found.point)
        statistic, degrees = change(self.healthy.owed, owed)
        statistic /= found.naming.temper
        return UnexplainedResidual(statistic, degrees, probability(statistic, degrees))

    def settled(self, found: Examination, chance: MinPDistribution) -> Examination:
        """Return the examination where the name stays when the models are linearised at the cause named."""
        steady = False
        for _ in range(NAME_STEPS):
            best = found.naming.named[0]
            new = np.zeros(len(found.point))
            new[[i for cause in best.causes for i in cause.columns]] = best.fit.sizes
            point = self.coordinates.healthy + self.null(found.news, new) + new
            try:
                news = ScoreStatistics.of(self.at(point), self.known)
                ratio, _ = self.variance(point)
            except SimulationError:  # too large a step for the model: what was reached before stays
                break
            naming = self.named(news, chance)
            if not naming.named:  # large at the healthy machine, and none where it was said to be
                break
            steady = naming.named[0].names == best.names
            ended = steady and _moved(naming, best.fit.sizes) < SETTLED
            found = replace(found, naming=naming, news=news, point=point, ratio=ratio)
            if ended:
                break
        return replace(found, steady=steady)


def _moved(naming: CauseRanking, sizes: Floats) -> float:
    """Return by how many standard deviations the sizes have moved at most."""
    now = naming.named[0].fit
    std = np.sqrt(np.diag(now.covariance))
    return float(np.max(np.abs(now.sizes - sizes) / np.where(std > 0, std, math.inf), initial=0.0))


def _information(machine: LinearizedMachine, whitening: Whitening, point: Floats, healthy: Floats) -> InformationMatrix:
    """Return what a record says of all coordinates, linearised at a point and relative to the healthy ones."""
    experiment = machine.experiment
    outputs, columns = machine.linearise(point)
    residual = _residual(experiment, outputs) + columns @ (point - healthy)
    white = whitening(experiment, np.concatenate([residual[:, :, None], columns], axis=2))
    return InformationMatrix.of(white[:, 1:], white[:, 0])


def _owed(machines: Sequence[LinearizedMachine], whitening: Whitening, point: Floats) -> InformationMatrix:
    """Return what the residuals of records at a point (N,) owe to the inputs before, beside all coordinates."""
    each = [_regressed(machine, whitening, point) for machine in machines]
    return sum(each[1:], start=each[0])


def _regressed(machine: LinearizedMachine, whitening: Whitening, point: Floats) -> InformationMatrix:
    experiment = machine.experiment
    outputs, columns = machine.linearise(point)
    inputs = lagged(experiment.input_values)
    residual = _residual(experiment, outputs)
    n, count = 1 + columns.shape[2], inputs.shape[1]
    beside = np.broadcast_to(inputs[:, None, :], (*residual.shape, count))
    whole = np.concatenate([residual[:, :, None], columns, beside], axis=2)
    there = np.flatnonzero(experiment.counted.any(axis=0)).tolist()
    white = [values for _, values in whitening.of_outputs(experiment, whole)]
    own = [np.zeros((len(values), count * residual.shape[1])) for values in white]
    for j, values, mine in zip(there, white, own, strict=True):  # each output has coefficients of its own
        mine[:, j * count : (j + 1) * count] = values[:, n:]
    every = np.vstack([values[:, :n] for values in white])
    return regression(every[:, 0], np.vstack(own), every[:, 1:])


def _residual(experiment: Experiment, outputs: Floats) -> Floats:
    """Return measured − simulated (K, n_outputs), 0 where no sample counts."""
    return np.where(experiment.counted, experiment.output_values - outputs, 0.0)
