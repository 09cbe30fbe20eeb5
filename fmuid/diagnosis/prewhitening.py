"""Whitening of a record by the noise that the healthy record showed.

A model of the noise taken from the new record would whiten the fault away with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.data import Experiment
from fmuid.estimation import Autoregression, NoiseModel, OutputSeries, common_process, output_series

# Samples over which a noise's correlations are summed.
SPECTRUM_LENGTH = 4096


@dataclass(frozen=True, eq=False)
class Whitening:
    """The noise of each output.

    Attributes
    ----------
    models : mapping of str to Autoregression
        By output.
    """

    models: Mapping[str, Autoregression]

    @classmethod
    def white(cls, variances: Mapping[str, float]) -> Whitening:
        """Return that of white noise of known variances."""
        return cls({name: Autoregression(np.zeros(0), variance, 0) for name, variance in variances.items()})

    @classmethod
    def of(
        cls, records: Sequence[tuple[Experiment, Floats]], variances: Mapping[str, float] | None = None
    ) -> Whitening:
        """Return that of the residuals of healthy records, those of each output together.

        Parameters
        ----------
        records : sequence of (Experiment, (K, n_outputs) array)
            With their residuals.
        variances : mapping of str to float, optional
            Of the outputs whose noise is given: they keep their variance, and have the residual's correlation.
        """
        parts: dict[str, list[tuple[OutputSeries, Floats]]] = {}
        for experiment, residual in records:
            for series in output_series([experiment], experiment.output_names):
                j = experiment.output_names.index(series.output)
                parts.setdefault(series.output, []).append((series, residual[experiment.counted[:, j], j]))
        return cls({name: common_process(own, (variances or {}).get(name)) for name, own in parts.items()})

    def std(self, output: str) -> float:
        """Return the standard deviation of an output's noise."""
        return self.models[output].std

    def independent_share(self, output: str) -> float:
        """Return how many independent samples one of an output is worth for its variance, 1/Σρ² (Bartlett)."""
        power = np.abs(self.models[output].transfer(SPECTRUM_LENGTH)) ** 2
        return float(np.mean(power) ** 2 / np.mean(power**2))

    def __call__(self, experiment: Experiment, columns: Floats) -> Floats:
        """Return the innovations of columns (K, n_outputs, m) at the counted samples, in units of their std (n, m).

        A sample is foretold by those before it that there are (`fmuid.estimation.noise.model`).
        """
        return np.vstack([white for _, white in self.of_outputs(experiment, columns)])

    def of_outputs(self, experiment: Experiment, columns: Floats) -> Iterator[tuple[Indices, Floats]]:
        """Yield the same of one output after the other, with the rows of the record that they belong to."""
        for series in output_series([experiment], experiment.output_names):
            j = experiment.output_names.index(series.output)
            rows = np.flatnonzero(experiment.counted[:, j])
            yield rows, NoiseModel(series, self.models[series.output]).whiten(columns[rows, j])


class Linearized(Protocol):
    """A machine over a record, with its derivatives."""

    experiment: Experiment

    def linearise(self, point: Floats) -> tuple[Floats, Floats]:
        """Return the outputs (K, n_outputs) at a point (N,), and their derivatives (K, n_outputs, N)."""
        raise NotImplementedError


def whitening_of(
    records: Sequence[Linearized], point: Floats, width: Floats, variances: Mapping[str, float] | None = None
) -> Whitening:
    """Return the noise of records, by what is left of them beside all coordinates.

    Parameters
    ----------
    records : sequence of LinearizedMachine
        Over the records.
    point : (N,) array
        Where they are linearised.
    width : (N,) array
        Standard deviation of what each coordinate may be off from there.
    variances : mapping of str to float, optional
        Of outputs whose noise is given.
    """
    residuals = []
    for record in records:
        outputs, columns = record.linearise(point)
        experiment = record.experiment
        rest = np.where(experiment.counted, experiment.output_values - outputs, 0.0)
        flat = columns[experiment.counted] * width
        # held by springs of its width in units of the residual itself
        scale = max(float(np.std(rest[experiment.counted])), np.finfo(float).tiny)
        stacked = np.vstack([flat / scale, np.eye(flat.shape[1])])
        target = np.concatenate([rest[experiment.counted] / scale, np.zeros(flat.shape[1])])
        taken = columns @ (np.linalg.lstsq(stacked, target, rcond=None)[0] * width)
        residuals.append((experiment, np.where(experiment.counted, rest - taken, 0.0)))
    return Whitening.of(residuals, variances)
