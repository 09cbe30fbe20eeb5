"""What is new in a record beside the healthy machine: all causes by their signatures, linearised where they are.

The healthy records say what the machine, its sensors and its supply are like, with the joint covariance of all of it; drifts that are no fault widen it; what the new record says beyond
that is tested at the level asked for; and the causes are weighed against each other. D at the healthy machine is too
small for large faults, or their name wrong: the models are linearised again at the cause named until the name stays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fmuid.arrays import Floats
from fmuid.data import Experiment
from fmuid.diagnosis.coordinates import Coordinates
from fmuid.diagnosis.evidence.detection import Chance
from fmuid.diagnosis.evidence.information import Information, Known, News
from fmuid.diagnosis.evidence.naming import MODEL_ERROR, Naming, name
from fmuid.diagnosis.linearisation import Machine
from fmuid.diagnosis.whitening import Whitening
from fmuid.errors import SimulationError

# The null estimate and the name are found again at most so often; a name that alternates ends there too.
NULL_STEPS, NAME_STEPS = 2, 4
# Sizes that move by less, in standard deviations, have settled.
SETTLED = 0.1


@dataclass(frozen=True, eq=False)
class Examination:
    """What a record says of all causes.

    Attributes
    ----------
    coordinates : Coordinates
    naming : Naming
        Sizes in the order of each explanation's coordinates.
    news : News
        At the point where the models were linearised last.
    point : (N,) array
        That point.
    steady : bool
        Whether the name stayed when the models were linearised again.
    """

    coordinates: Coordinates
    naming: Naming
    news: News
    point: Floats
    steady: bool


@dataclass(frozen=True, eq=False)
class Healthy:
    """What the healthy machine is like, as new records are compared with it.

    Attributes
    ----------
    known : Known
        Of all coordinates, relative to the healthy ones.
    whitening : Whitening
    drift : (N,) array
        Standard deviation of what may change without being a fault.
    """

    known: Known
    whitening: Whitening
    drift: Floats


def healthy_of(
    records: Sequence[Machine],
    whitening: Whitening,
    coordinates: Coordinates,
    covariance: Floats,
    drift: Floats,
) -> Healthy:
    """Return what healthy records leave known.

    Parameters
    ----------
    records : sequence of Machine
        Over the healthy records; without any, the sensors may be as far off as is normal, and no fault is there.
    whitening : Whitening
    coordinates : Coordinates
    covariance : (n, n) array
        Of the healthy parameters; only where there are no records.
    drift : (N,) array

    Raises
    ------
    SimulationError
        If the healthy machine cannot be simulated.
    """
    if records:
        said = [_information(machine, whitening, coordinates.healthy, coordinates.healthy) for machine in records]
        return Healthy(Known.after_several(said, coordinates.normal), whitening, drift)
    whole = np.diag(coordinates.normal**2)
    n = len(covariance)
    whole[:n, :n] = covariance
    return Healthy(Known(np.zeros(len(whole)), whole), whitening, drift)


def examine(
    machines: Sequence[Machine],
    healthy: Healthy,
    coordinates: Coordinates,
    level: float,
    model_error: float = MODEL_ERROR,
) -> Examination:
    """Say what is new in records of one machine.

    Parameters
    ----------
    machines : sequence of Machine
        Over the new records.
    healthy : Healthy
    coordinates : Coordinates
    level : float
        Probability of an alarm where nothing is new.
    model_error : float
        κ (`fmuid.diagnosis.evidence.naming`).

    Raises
    ------
    SimulationError
        If the healthy machine cannot be simulated.
    """
    known = healthy.known.drifting(healthy.drift)

    def at(point: Floats) -> Information:
        said = [_information(machine, healthy.whitening, point, coordinates.healthy) for machine in machines]
        total = said[0]
        for each in said[1:]:
            total = total + each
        return total

    point = coordinates.healthy
    said = at(point)
    for _ in range(NULL_STEPS):
        news = News.of(said, known)
        point = coordinates.healthy + known.mean + known.covariance @ news.score
        said = at(point)
    news = News.of(said, known)
    naming = name(news, coordinates.causes, level, chance=Chance.of(news, coordinates.causes), model_error=model_error)
    return _settled(at, known, coordinates, Examination(coordinates, naming, news, point, True), level, model_error)


def _settled(
    at: Callable[[Floats], Information],
    known: Known,
    coordinates: Coordinates,
    found: Examination,
    level: float,
    model_error: float,
) -> Examination:
    """Return the examination where the name stays when the models are linearised at the cause named."""
    for _ in range(NAME_STEPS if found.naming.named else 0):
        best = found.naming.named[0]
        columns = [i for cause in best.causes for i in cause.columns]
        new = np.zeros(len(found.point))
        new[columns] = best.fit.sizes
        rest = found.news.score - found.news.information @ new
        point = coordinates.healthy + known.mean + known.covariance @ rest + new
        try:
            news = News.of(at(point), known)
        except SimulationError:
            return Examination(coordinates, found.naming, found.news, found.point, False)
        naming = name(news, coordinates.causes, level, model_error=model_error)
        same = bool(naming.named) and naming.named[0].names == best.names
        settled = same and _moved(naming, best.fit.sizes) < SETTLED
        found = Examination(coordinates, naming if naming.named else found.naming, news, point, same)
        if settled or not naming.named:
            break
    return found


def _moved(naming: Naming, sizes: Floats) -> float:
    """Return by how many standard deviations the sizes have moved at most."""
    now = naming.named[0].fit
    std = np.sqrt(np.diag(now.covariance))
    return float(np.max(np.abs(now.sizes - sizes) / np.where(std > 0, std, math.inf), initial=0.0))


def _information(machine: Machine, whitening: Whitening, point: Floats, healthy: Floats) -> Information:
    """Return what a record says of all coordinates, linearised at a point and relative to the healthy ones."""
    experiment: Experiment = machine.experiment
    outputs, columns = machine.linearise(point)
    residual = np.where(experiment.counted, experiment.output_values - outputs, 0.0) + columns @ (point - healthy)
    white = whitening(experiment, np.concatenate([residual[:, :, None], columns], axis=2))
    return Information.of(white[:, 1:], white[:, 0])
