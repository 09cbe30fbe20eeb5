"""Statistics of healthy records, with which new records are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.diagnosis.baseline import BaselineSource, StoredBaseline
from fmuid.diagnosis.causes import SETTINGS as CAUSES
from fmuid.diagnosis.causes import CauseKind, ChangeParameterSet, line_scale
from fmuid.diagnosis.information_matrix import ChangePrior, InformationMatrix, Whitening
from fmuid.diagnosis.linearized_machine import LinearizedMachine, residual_and_columns
from fmuid.diagnosis.noise_ratios import NoiseRatios
from fmuid.diagnosis.onset_tracker import OnsetTracker
from fmuid.diagnosis.operating_points import OperatingPoints
from fmuid.diagnosis.population import Population, Scales, tempered
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.diagnosis.unexplained_residual import HealthyStructure, StructureStatistics, lagged, levels


@dataclass(frozen=True, eq=False)
class BaselineStatistics:
    """Statistics of the healthy machine, compared with new records."""

    known: ChangePrior  # of all coordinates, relative to the healthy ones
    whitening: Whitening
    drift: Floats  # (N,) standard deviation of changes that are no fault
    structure: StructureStatistics | None = None  # of healthy residuals; None without records
    noise: NoiseRatios | None = None  # of the same residuals
    basis: BaselineSource = BaselineSource.RESULT
    population: Population | None = None
    points: OperatingPoints | None = None

    def tracker(self) -> OnsetTracker:
        """Return a tracker before any window: each may be at an operating point of its own."""
        drift, healthy = np.diag(self.drift**2), self.population
        if healthy is None or not healthy.scatter.any():
            return OnsetTracker(self.known, drift)
        return OnsetTracker(self.known, drift + healthy.scatter, healthy.scatter, healthy.records - 1.0)

    @classmethod
    def of(
        cls,
        shown: StoredBaseline,
        coordinates: ChangeParameterSet,
        drift: Floats,
        basis: BaselineSource = BaselineSource.RECORDS,
    ) -> BaselineStatistics:
        """Return the statistics of healthy records."""
        sound = np.isnan(coordinates.without_faults(np.full(drift.size, math.nan)))
        scales = (coordinates.normal, drift, coordinates.scatter, sound)
        population, structure, noise = _population(shown, *(tuple(each.tolist()) for each in scales))
        return cls(population.known, shown.whitening, drift, structure, noise, basis, population, shown.points)


@lru_cache(maxsize=8)  # for many records of one machine
def _population(
    shown: StoredBaseline,
    normal: tuple[float, ...],
    drift: tuple[float, ...],
    scatter: tuple[float, ...],
    sound: tuple[bool, ...],
) -> tuple[Population, StructureStatistics, NoiseRatios]:
    """Return population, structure and noise of a baseline's records."""
    scales = Scales(np.array(normal), np.array(drift), np.array(scatter))
    plain = Population.of(shown.said, scales)
    others = list(plain.without_each(shown.said, scales))
    wide = ChangePrior(0.0 * scales.normal, np.diag(scales.normal**2))  # a few records are each by itself
    population, squares = tempered(plain, shown.said, others), []
    for record, outputs, beside in zip(shown.said, shown.outputs, others, strict=True):
        point = np.where(sound, beside.after_also(record).mean, 0.0)
        squares.append([each.squares_at(point) for each in outputs])
    shares = np.array([noise.share for noise in shown.whitening.models.values()])
    structure = StructureStatistics.of(shown.structure, others if plain.scatter.any() else [wide] * len(others))
    return population, structure, NoiseRatios(np.array(squares) / shown.samples, shares * shown.samples)


def shown_by(
    records: Sequence[LinearizedMachine], whitening: Whitening, coordinates: ChangeParameterSet
) -> StoredBaseline:
    """Return the sums of healthy records, each linearized at its own estimate."""
    outputs, samples = list[list[InformationMatrix]](), list[list[int]]()
    places = [own_point(machine, whitening, coordinates) for machine in records]
    for machine, place in zip(records, places, strict=True):
        columns, off = residual_and_columns(machine, place), place - coordinates.healthy
        found = {name: values for name, _, values in whitening.of_outputs(machine.experiment, columns)}
        white = [found[name] for name in whitening.models]
        outputs.append([InformationMatrix.of(each[:, 1:], each[:, 0] + each[:, 1:] @ off) for each in white])
        samples.append(list(map(len, white)))
    parts = tuple(structure_of([each], whitening, place) for each, place in zip(records, places, strict=True))
    counts = np.array(samples)
    structure = HealthyStructure(_groups(records[0].experiment, coordinates), parts, int(counts.sum()))
    points = OperatingPoints.of([machine.experiment for machine in records])
    lines = line_scale(records[0].experiment)
    return StoredBaseline(outputs, counts, structure, points, whitening, lines)


def own_point(machine: LinearizedMachine, whitening: Whitening, coordinates: ChangeParameterSet) -> Floats:
    """Return the estimate (N,) of a healthy record alone."""
    point = coordinates.healthy
    for _ in range(CAUSES.null_steps):
        said = information_of(machine, whitening, point, coordinates.healthy)
        target = coordinates.healthy + ChangePrior.after(said, coordinates.normal).mean
        target = coordinates.without_faults(target)
        if said.curvature(target - point, coordinates.magnitude) < CAUSES.close:
            break
        point = coordinates.toward(point, target)
    return point


def information_of(
    machine: LinearizedMachine, whitening: Whitening, point: Floats, healthy: Floats
) -> InformationMatrix:
    """Return a record's information at a point, relative to healthy coordinates."""
    white = whitening(machine.experiment, residual_and_columns(machine, point))
    return InformationMatrix.of(white[:, 1:], white[:, 0] + white[:, 1:] @ (point - healthy))


def _groups(experiment: Experiment, coordinates: ChangeParameterSet) -> dict[str, tuple[int, ...]]:
    """Return the columns of each group of `structure_of`."""
    inputs, outputs = experiment.input_names, experiment.of_model.output_names
    parameters = [coordinates.each[i].name for i in coordinates.of(CauseKind.PARAMETER)]
    count = 1 + (len(UNEXPLAINED_RESIDUAL.spans) - 1) * len(inputs)
    sizes = {f"inputs to {output}": count for output in outputs}
    sizes |= {f"{name} by {how}": len(inputs + outputs) for how in ("sizes", "levels") for name in parameters}
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: tuple(range(*each)) for name, each in zip(sizes, pairwise(ends), strict=True)}


def structure_of(machines: Sequence[LinearizedMachine], whitening: Whitening, point: Floats) -> InformationMatrix:
    """Return the information on all coordinates and groups, relative to healthy coordinates."""
    first, *others = (_regressed(machine, whitening, point) for machine in machines)
    return sum(others, start=first)


def _regressed(machine: LinearizedMachine, whitening: Whitening, point: Floats) -> InformationMatrix:
    experiment, whole = machine.experiment, residual_and_columns(machine, point)
    whole[:, :, 0] += whole[:, :, 1:] @ (point - machine.coordinates.healthy)
    inputs, outputs = experiment.input_values, machine.in_axes(machine.outputs(point))
    lags, count = lagged(inputs), outputs.shape[1]
    # each output of the model has coefficients of its own
    slopes = np.einsum("kc,mj->kmjc", lags, np.eye(count)).reshape(len(lags), count, -1)
    varying = whole[:, :, [1 + i for i in machine.coordinates.of(CauseKind.PARAMETER)]]
    by = [np.einsum("kop,ks->kops", varying, each) for each in levels(np.hstack([inputs, outputs]))]
    columns = [machine.sensed(slopes), *(each.reshape(*varying.shape[:2], -1) for each in by)]
    white = whitening(experiment, np.concatenate([whole, *columns], axis=2))
    return InformationMatrix.of(white[:, 1:], white[:, 0])
