"""What is new in a record beside the healthy machine: all causes by their signatures, linearised where they are.

The baseline says what the machine, its sensors and its supply are like, with the joint covariance of all of it;
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
from fmuid.diagnosis.baseline import StoredBaseline
from fmuid.diagnosis.cause_ranking import MODEL_ERROR, CauseRanking, name
from fmuid.diagnosis.causes import SETTINGS as CAUSES
from fmuid.diagnosis.causes import Cause, ChangeParameterSet
from fmuid.diagnosis.change_detection import MinPDistribution, fit
from fmuid.diagnosis.information_matrix import (
    ChangePrior,
    InformationMatrix,
    ScoreStatistics,
    is_determined,
)
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from fmuid.diagnosis.prewhitening import Whitening, whitening_of
from fmuid.diagnosis.unexplained_residual import (
    NOTHING_LEFT,
    UnexplainedResidual,
    change,
    lagged,
    probability,
    regression,
)
from fmuid.errors import SimulationError


@dataclass(frozen=True)
class AnalysisSettings:
    """Numbers of the analysis.

    Attributes
    ----------
    null_steps, name_steps : int
        Linearisations at the null estimate and at the cause named; a name that alternates ends there too.
    settled : float
        Sizes that move by less, in standard deviations, have settled.
    tolerated : float
        The largest error seen in trials over κ: three standard deviations.
    """

    null_steps: int = 2
    name_steps: int = 4
    settled: float = 0.1
    tolerated: float = 3.0


SETTINGS = AnalysisSettings()


@dataclass(frozen=True, eq=False)
class Linearization:
    """What records say, linearised at a point.

    Attributes
    ----------
    point : (N,) array
    said : InformationMatrix
        On all coordinates, relative to the healthy ones.
    news : ScoreStatistics
        What is new of it.
    causes : tuple of Cause
        Those that the records determine beside all that may change.
    whitening : Whitening
        By which the records were made white.
    """

    point: Floats
    said: InformationMatrix
    news: ScoreStatistics
    causes: tuple[Cause, ...]
    whitening: Whitening


@dataclass(frozen=True, eq=False)
class Examination:
    """What a record says of all causes.

    Attributes
    ----------
    coordinates : ChangeParameterSet
    naming : CauseRanking
        Sizes in the order of each explanation's coordinates.
    at : Linearization
        Where the models were linearised last.
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
    estimate : ChangePrior
        All coordinates, relative to the healthy ones, beside what was named.
    residuals : pair of (K, n_outputs) array
        Of the first record, without anything new and with what was named.
    """

    coordinates: ChangeParameterSet
    naming: CauseRanking
    at: Linearization
    model_error: float
    ratio: float
    without: float
    samples: int
    steady: bool
    remainder: UnexplainedResidual
    estimate: ChangePrior
    residuals: tuple[Floats, Floats]


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
        What the residuals of the healthy records owe to the inputs. None without records: the noise then has the
        color of what the new record leaves beside all coordinates.
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
        κ (`fmuid.diagnosis.cause_ranking`).

    Raises
    ------
    SimulationError
        If the healthy machine cannot be simulated.
    """
    work = _CauseAnalyzer(machines, healthy, coordinates, level, model_error)
    at = work.at(coordinates.healthy)
    for _ in range(SETTINGS.null_steps):
        at = work.at(coordinates.healthy + work.null(at.news))
    chance, null = MinPDistribution.of(at.news, at.causes), at.point
    naming, steady = work.named(at, chance), True
    without = ratio = work.variance(null)
    if naming.named:
        naming, at, ratio, steady = work.settled(naming, at, chance, ratio)
    residuals = [_residual(machines[0].experiment, machines[0].outputs(point)) for point in (null, at.point)]
    return Examination(
        coordinates,
        naming,
        at,
        model_error,
        ratio,
        without,
        sum(int(np.count_nonzero(each.experiment.counted)) for each in machines),
        steady,
        work.remainder(at, naming),
        work.estimate(at, naming),
        (residuals[0], residuals[1]),
    )


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
    news = found.at.news
    plain, own = replace(cause, sign=0), fit(news, (cause,)).statistic
    others = [replace(each, sign=0) for each in coordinates.causes if each is not cause]
    left = [fit(news, (plain, other)).statistic - own - len(other.columns) for other in others]
    return math.sqrt(max(0.0, *left) / own) / SETTINGS.tolerated if left else 0.0


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

    def at(self, point: Floats) -> Linearization:
        """Return what the records say, linearised at a point (N,)."""
        whitening, healthy = self.healthy.whitening, self.coordinates.healthy
        if self.healthy.owed is None:
            variances = {name: whitening.std(name) ** 2 for name in whitening.models}
            whitening = whitening_of(self.machines, point, CAUSES.open * self.coordinates.normal, variances)
        first, *others = (_information(machine, whitening, point, healthy) for machine in self.machines)
        said = sum(others, start=first)
        news = ScoreStatistics.of(said, self.known)
        causes = (each for each in self.coordinates.causes if is_determined(news, said, each.columns))
        return Linearization(point, said, news, tuple(causes), whitening)

    def null(self, news: ScoreStatistics, new: Floats | None = None) -> Floats:
        """Return the estimate of everything beside what is new (N,), relative to the healthy machine."""
        score = news.score if new is None else news.score - news.information @ new
        return np.asarray(self.known.mean + self.known.covariance @ score)

    def estimate(self, at: Linearization, naming: CauseRanking) -> ChangePrior:
        """Return the estimate of everything beside what was named, relative to the healthy machine."""
        new, columns, spread = np.zeros(at.point.size), list[int](), np.zeros((0, 0))
        if naming.named:
            columns, spread = naming.named[0].columns, naming.named[0].fit.covariance
            new[columns] = naming.named[0].fit.sizes
        shared = self.known.covariance @ at.news.information[:, columns]
        covariance = self.known.after_also(at.said).covariance
        return ChangePrior(self.null(at.news, new), covariance + shared @ spread @ shared.T)

    def named(self, at: Linearization, chance: MinPDistribution) -> CauseRanking:
        """Return what is new."""
        return name(at.news, at.causes, self.level, chance=chance, model_error=self.model_error)

    def variance(self, point: Floats) -> float:
        """Return the variance of the residual at a point against that of the noise."""
        squares, samples = 0.0, 0
        for machine in self.machines:
            outputs = machine.outputs(point)
            white = self.healthy.whitening(machine.experiment, _residual(machine.experiment, outputs)[:, :, None])
            squares, samples = squares + float(np.sum(white**2)), samples + white.size
        return squares / samples

    def remainder(self, at: Linearization, naming: CauseRanking) -> UnexplainedResidual:
        """Return the change of what the residual owes to the inputs, beside all causes and the models' error."""
        if self.healthy.owed is None:
            return NOTHING_LEFT
        statistic, degrees = change(self.healthy.owed, _owed(self.machines, self.healthy.whitening, at.point))
        statistic /= naming.temper
        return UnexplainedResidual(statistic, degrees, probability(statistic, degrees))

    def settled(
        self, naming: CauseRanking, at: Linearization, chance: MinPDistribution, ratio: float
    ) -> tuple[CauseRanking, Linearization, float, bool]:
        """Linearise at the cause named until the name stays: what is named, where, with which variance, and if so."""
        steady = False
        for _ in range(SETTINGS.name_steps):
            best = naming.named[0]
            new = np.zeros(at.point.size)
            new[best.columns] = best.fit.sizes
            try:
                there = self.at(self.coordinates.healthy + self.null(at.news, new) + new)
                with_ = self.variance(there.point)
            except SimulationError:  # too large a step for the model: what was reached before stays
                break
            found = self.named(there, chance)
            if not found.named:  # large at the healthy machine, and none where it was said to be
                break
            steady = found.named[0].names == best.names
            naming, at, ratio = found, there, with_
            if steady and _moved(found, best.fit.sizes) < SETTINGS.settled:
                break
        return naming, at, ratio, steady


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
