"""Measured against simulated outputs of an experiment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pandas as pd

from fmuid.array_types import Flags, Floats
from fmuid.codec import Layout
from fmuid.data import Experiment, FrequencyExperiment, response_of
from fmuid.models import System
from fmuid.simulation.predictors import output_unit


@dataclass(frozen=True, eq=False)
class InputSignals:
    """Recorded inputs of an experiment in time."""

    names: tuple[str, ...]
    units: tuple[str | None, ...]
    held: tuple[bool, ...]  # inputs with zero-order hold
    values: Floats  # (K, n_inputs), in the units of the data

    json_layout: ClassVar = Layout(omitted={"values"})


@dataclass(frozen=True, eq=False)
class OutputFit:
    """Measured against simulated outputs of one experiment."""

    experiment: str
    times: Floats  # (K,), s
    outputs: tuple[str, ...]
    units: tuple[str | None, ...]  # of the outputs, in the data file
    measured: Floats  # (K, n_outputs), NaN without measurement, as `simulated`
    simulated: Floats
    counted: Flags  # samples in the cost function (K, n_outputs)
    kind: str = "time"  # of the experiment
    axis: Mapping[str, Floats] = field(default_factory=dict)  # first columns of tables, (K,) each; default: the times
    # change of each output (K, n_outputs) by one relative unit of its complex response; None of others
    readings: Floats | None = None
    conjugate: tuple[str, ...] = ()  # responses whose imaginary part has the reversed sign
    inputs: InputSignals | None = None  # of an experiment in time

    json_layout: ClassVar = Layout(
        omitted={"times", "measured", "simulated", "counted"}, derived=("counted_from", "fit", "rmse")
    )

    @property
    def fit(self) -> tuple[float, ...]:
        """Fit of each output over the counted samples, % (`nrmse_fit`); of a response 100 less its relative error."""
        if self.readings is not None:
            return self._response_fit(self.readings)
        return tuple(nrmse_fit([pair]) for pair in self._counted_pairs)

    def _response_fit(self, readings: Floats) -> tuple[float, ...]:
        """Return the fit of complex responses, equal for their parts."""
        errors = np.where(self.counted, (self.measured - self.simulated) / readings, 0.0)
        names, found = [response_of(name) for name in self.outputs], []
        for name in names:
            own = [j for j, each in enumerate(names) if each == name]
            rows = self.counted[:, own].any(axis=1)
            square = (errors[:, own] ** 2).sum(axis=1)[rows]
            found.append(100.0 * (1.0 - math.sqrt(float(square.mean()))) if rows.any() else math.nan)
        return tuple(found)

    @property
    def rmse(self) -> tuple[float, ...]:
        """RMS of measured − simulated of each output, in `units`."""
        return tuple(root_mean_square(*pair) for pair in self._counted_pairs)

    @property
    def _counted_pairs(self) -> list[tuple[Floats, Floats]]:
        columns = zip(self.measured.T, self.simulated.T, self.counted.T, strict=True)
        return [(measured[counted], simulated[counted]) for measured, simulated, counted in columns]

    @property
    def counted_from(self) -> float | None:
        """First counted time, s; None without any."""
        counted = self.counted.any(axis=1)
        return float(self.times[int(counted.argmax())]) if counted.any() else None

    def frame(self) -> pd.DataFrame:
        """Return ``time``, ``measured.`` and ``simulated.`` of each output, ``input.`` of each input."""
        columns = dict(self.axis) or {"time": self.times}
        for j, name in enumerate(self.outputs):
            columns |= {f"measured.{name}": self.measured[:, j], f"simulated.{name}": self.simulated[:, j]}
        return pd.DataFrame(columns | self.input_columns)

    @property
    def input_columns(self) -> dict[str, Floats]:
        """Columns ``input.`` of each input, (K,) each."""
        given = self.inputs
        return {} if given is None else {f"input.{name}": given.values[:, j] for j, name in enumerate(given.names)}

    def simulated_frame(self) -> pd.DataFrame:
        """Return the columns ``time`` and each output."""
        first = dict(self.axis) or {"time": self.times}
        return pd.DataFrame({**first, **dict(zip(self.outputs, self.simulated.T, strict=True))})


def nrmse_fit(pairs: Sequence[tuple[Floats, Floats]]) -> float:
    """Return the NRMSE fit 100 (1 − ‖y − ŷ‖/‖y − ȳ‖) of one output, %; NaN for a constant one.

    Each experiment has a measured y (n,), a simulated ŷ (n,), and its own mean ȳ.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable simulation: −infinite
        error = math.hypot(*(float(np.linalg.norm(y - simulated)) for y, simulated in pairs))
        moving = [y - y.mean() for y, _ in pairs if y.size and np.ptp(y) > 0.0]
        spread = math.hypot(*(float(np.linalg.norm(each)) for each in moving))
    return 100.0 * (1.0 - error / spread) if spread > 0.0 else math.nan


def root_mean_square(measured: Floats, simulated: Floats) -> float:
    """Return the RMS of measured − simulated (n,); NaN without samples."""
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable simulation: infinite
        size = float(np.linalg.norm(measured - simulated))
    return size / math.sqrt(measured.size) if measured.size else math.nan


def fit_of(system: System, experiment: Experiment, simulated: Floats) -> OutputFit:
    """Return simulated outputs (K, n_outputs) with the measured ones."""
    names = experiment.output_names
    units = tuple(output_unit(system, experiment, name) for name in names)
    readings: Floats | None = None
    conjugate: tuple[str, ...] = ()
    if isinstance(experiment, FrequencyExperiment):
        readings = np.column_stack([experiment.readings(name) for name in names])
        conjugate = tuple(name for name, each in experiment.responses.items() if each.conjugate)
    values = experiment.output_values, simulated, experiment.counted
    made = OutputFit(experiment.name, experiment.times, names, units, *values, experiment.kind, experiment.axis)
    return replace(made, readings=readings, conjugate=conjugate, inputs=_inputs_of(system, experiment))


def _inputs_of(system: System, experiment: Experiment) -> InputSignals | None:
    """Return the recorded inputs of an experiment in time."""
    names = experiment.input_names
    if experiment.kind != "time" or not names:
        return None
    units = tuple(experiment.units.get(name) or system.unit(name) for name in names)
    return InputSignals(names, units, tuple(experiment.held.tolist()), experiment.input_values)


def parameter_units(
    system: System, names: Sequence[str], experiments: Sequence[Experiment] = ()
) -> tuple[str | None, ...]:
    """Return the unit of each parameter, also of ``variable[experiment]`` and of sensors."""
    variables = system.variables

    def unit(name: str) -> str | None:
        own = name if name in variables or name.endswith(")") else name.rpartition("[")[0]
        if own in variables:
            return variables[own].unit
        seen = (each for each in experiments if each.observation is not None and own in each.observation.names)
        return next((each.observation.unit(own, each.units) for each in seen if each.observation is not None), None)

    return tuple(map(unit, names))
