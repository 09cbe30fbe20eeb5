"""Whitening of a record by the noise that the healthy record showed.

A model of the noise taken from the new record would whiten the fault away with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from fmuid.array_types import Floats, Indices
from fmuid.data import Experiment
from fmuid.estimation import Autoregression, autoregression, innovations_matrix, output_series


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
        models = {}
        outputs = dict.fromkeys(name for experiment, _ in records for name in experiment.output_names)
        for name in outputs:
            placed = [_placed(experiment, residual, name) for experiment, residual in records]
            whole = np.concatenate([np.append(each, np.nan) for each in placed])  # a gap between records
            found = autoregression(whole, np.isfinite(whole))
            if variances is not None and name in variances:
                found = replace(found, variance=variances[name] / found.gain)
            models[name] = found
        return cls(models)

    def std(self, output: str) -> float:
        """Return the standard deviation of an output's noise."""
        model = self.models[output]
        return float((model.variance * model.gain) ** 0.5)

    def __call__(self, experiment: Experiment, columns: Floats) -> Floats:
        """Return the innovations of columns (K, n_outputs, m) at the counted samples, in units of their std (n, m).

        A sample is foretold by those before it that there are (`fmuid.estimation.noise.model`).
        """
        return np.vstack([white for _, white in self.of_outputs(experiment, columns)])

    def of_outputs(self, experiment: Experiment, columns: Floats) -> Iterator[tuple[Indices, Floats]]:
        """Yield the same of one output after the other, with the rows of the record that they belong to."""
        for series in output_series([experiment], experiment.output_names):
            model = self.models[series.output]
            j = experiment.output_names.index(series.output)
            rows = np.flatnonzero(experiment.counted[:, j])
            yield rows, innovations_matrix(model, series.places) @ columns[rows, j] / self.std(series.output)


def _placed(experiment: Experiment, residual: Floats, name: str) -> Floats:
    """Return one output's residual on the grid of its samples, NaN between them; empty where it has none."""
    for series in output_series([experiment], experiment.output_names):
        if series.output == name:
            j = experiment.output_names.index(name)
            return series.on_grid(residual[experiment.counted[:, j], j])
    return np.zeros(0)


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
