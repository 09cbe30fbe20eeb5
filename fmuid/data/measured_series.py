"""The samples of an output, by their content."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from fmuid.data.experiment import Experiment


@dataclass(frozen=True)
class MeasuredSeries:
    """The samples of one output of one experiment that count.

    Attributes
    ----------
    unit : str
        Of the samples, "" where it is the model's.
    digest : str
        Of their times and values, as the table has them: equal for equal samples, whatever output they are taken for.
    reading : float
        RMS magnitude of the response they are part of; 0 of others.
    """

    experiment: str
    output: str
    unit: str
    samples: int
    digest: str
    reading: float = 0.0


def measured_series(experiment: Experiment) -> tuple[MeasuredSeries, ...]:
    """Return the series of an experiment, one an output."""
    found = []
    for j, output in enumerate(experiment.output_names):
        counted = experiment.counted[:, j]
        samples = np.empty((np.count_nonzero(counted), 2), "<f8")
        samples[:, 0], samples[:, 1] = experiment.times[counted], experiment.output_values[counted, j]
        digest = hashlib.sha256(samples.data).hexdigest()[:16]  # equal by chance once in 10^19
        size = 0.0
        if experiment.kind == "frequency" and len(samples):
            size = float(np.sqrt(np.mean(experiment.readings(output)[counted] ** 2)))
        unit = experiment.units.get(output, "")
        found.append(MeasuredSeries(experiment.name, output, unit, len(samples), digest, size))
    return tuple(found)
