"""Sensitivity functions over time, and the σ that an excitation promises.

Normalized sensitivities θ_n ∂ŷ/∂θ_n (1.33) are in the output's unit. Their covariance (1.31) ranks excitations, by the
determinant of the information (D-optimal; Atkinson, Donev, Tobias, 2007, chapter 10) or by the worst relative σ.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import Experiment, Noise, Parameter, ParameterSet
from fmuid.errors import InputError
from fmuid.estimation import parabola_slope
from fmuid.identification.acquisition_delay import delay_basis, secants, without_delay
from fmuid.models import System
from fmuid.simulation import Value, output_unit, simulator_of

STEP = 1e-3  # of central differences, relative to the magnitude; their error is of its square
SINGULAR = 1e-11  # least information of an identifiable direction, relative; errors of differences leave STEP⁴


@dataclass(frozen=True, eq=False)
class SensitivityFunctions:
    """Normalized sensitivities over one experiment."""

    experiment: str
    axis: Mapping[str, Floats]  # times (K,), s; of rows without a time their numbers and inputs
    outputs: tuple[str, ...]
    units: tuple[str, ...]  # of outputs and sensitivities; "" without
    parameters: tuple[str, ...]
    values: Floats  # (K, n_outputs, N), magnitude of the parameter times ∂ŷ/∂θ
    magnitudes: Floats  # (N,)
    simulated: Floats  # (K, n_outputs)

    @property
    def table(self) -> pd.DataFrame:
        """Time (s) or rows, and a column ``output/parameter`` for each pair."""
        columns = dict(self.axis)
        for j, output in enumerate(self.outputs):
            columns |= {f"{output}/{name}": self.values[:, j, i] for i, name in enumerate(self.parameters)}
        return pd.DataFrame(columns)

    @property
    def sizes(self) -> pd.DataFrame:
        """Root mean squares: a row for each parameter, a column for each output."""
        return pd.DataFrame(
            np.sqrt(np.mean(self.values**2, axis=0)).T, index=list(self.parameters), columns=list(self.outputs)
        )


@dataclass(frozen=True, eq=False)
class ExpectedAccuracy:
    """Expected σ of the estimates from an excitation."""

    excitation: str
    duration: float  # s; NaN of rows without a time
    std: dict[str, float]  # infinite where not identifiable
    relative: dict[str, float]  # over the parameter's magnitude
    log_determinant: float  # of the information of relative parameters; −infinity if a direction is not identifiable

    @property
    def worst(self) -> float:
        """The largest relative standard deviation."""
        return max(self.relative.values())


def sensitivity_functions(
    model: System,
    experiment: Experiment,
    parameters: Mapping[str, Parameter],
    values: Mapping[str, Value] | None = None,
) -> SensitivityFunctions:
    """Compute the normalized sensitivities at the initial guess, by central differences.

    `InputError`: model, experiment and parameters do not fit together. `SimulationError`: a simulation fails.
    """
    flat = ParameterSet(parameters, [experiment.name])
    simulator = simulator_of(model, experiment, tuple(parameters), values or {})
    magnitudes = flat.reach(flat.start)
    # beside a bound both points lie on the other side of it
    offsets = np.tile([-1.0, 1.0], (len(flat), 1))
    offsets[flat.start - STEP * magnitudes < flat.lower] = [1.0, 2.0]
    offsets[flat.start + STEP * magnitudes > flat.upper] = [-1.0, -2.0]
    points = np.tile(flat.start, (2 * len(flat) + 1, 1))
    for i in range(len(flat)):
        points[[2 * i + 1, 2 * i + 2], i] += offsets[i] * STEP * magnitudes[i]
    outputs = simulator(points)
    a, b = STEP * offsets[:, 0, None, None], STEP * offsets[:, 1, None, None]
    low, high = outputs[1::2] - outputs[0], outputs[2::2] - outputs[0]
    slopes = parabola_slope(low, high, a, b)
    units = tuple(output_unit(model, experiment, name) or "" for name in experiment.output_names)
    return SensitivityFunctions(
        experiment.name,
        experiment.axis,
        experiment.output_names,
        units,
        tuple(parameters),
        np.moveaxis(slopes, 0, -1),
        magnitudes,
        outputs[0],
    )


def expected_accuracy(
    model: System,
    excitation: Experiment,
    parameters: Mapping[str, Parameter],
    variance: Mapping[str, float | Floats],
    values: Mapping[str, Value] | None = None,
    delay_std: float = Noise().delay_in(""),
) -> ExpectedAccuracy:
    """Compute the expected σ of an excitation at the initial guess.

    It includes a delay between inputs and outputs with `delay_std`, samples.

    The excitation is measured, or planned (`fmuid.diagnosis.planned_experiment`). The noise variance of each output is
    a number or (K,), in the unit of the excitation's data. Errors as of `sensitivity_functions`.
    """
    for name in excitation.output_names:
        if name not in variance:
            raise InputError(f'noise level of {name!r} is unknown. Set noise.variance = {{ "{name}" = ... }}.')
    found = sensitivity_functions(model, excitation, parameters, values)
    variances = [np.broadcast_to(variance[name], len(excitation.times)) for name in excitation.output_names]
    levels, counted = np.sqrt(np.column_stack(variances)), excitation.counted
    rows = (found.values / levels[:, :, None])[counted]
    if excitation.kind == "time" and excitation.input_names:
        delays = secants(excitation, found.simulated, delay_std)
        rows = without_delay(rows, *delay_basis(np.column_stack([(each / levels)[counted] for each in delays])))
    flat = ParameterSet(parameters, [excitation.name])
    rows = np.vstack([rows, flat.prior_whitening * found.magnitudes])
    _, singular, directions = np.linalg.svd(rows, full_matrices=False)
    known = singular > math.sqrt(SINGULAR) * singular[0] if singular.size and singular[0] > 0 else singular > 0
    std = np.sqrt(np.sum((directions[known] / singular[known, None]) ** 2, axis=0))
    lost = (np.abs(directions[~known]) > STEP).any(axis=0) | (len(singular) < len(flat))
    relative = np.where(lost, math.inf, std)
    whole = bool(known.all()) and len(singular) == len(flat)
    names = found.parameters
    return ExpectedAccuracy(
        excitation.name,
        float(np.ptp(excitation.times)) if excitation.kind == "time" else math.nan,
        dict(zip(names, (relative * found.magnitudes).tolist(), strict=True)),
        dict(zip(names, relative.tolist(), strict=True)),
        2.0 * float(np.log(singular).sum()) if whole else -math.inf,
    )


def rank_excitations(found: Sequence[ExpectedAccuracy], *, by: str = "determinant") -> pd.DataFrame:
    """Compare excitations: one row each, the best first, by "determinant" (D-optimal) or the "worst" relative σ.

    Columns: ``excitation``, ``duration`` (s), ``log_determinant``, ``worst``, and for each parameter its ``.std``.
    """
    if by not in ("determinant", "worst"):
        raise InputError(f'by: must be "determinant" or "worst", not {by!r}.')
    rows = [
        {
            "excitation": each.excitation,
            "duration": each.duration,
            "log_determinant": each.log_determinant,
            "worst": each.worst,
            **{f"{name}.std": std for name, std in each.std.items()},
        }
        for each in found
    ]
    key, rising = ("log_determinant", False) if by == "determinant" else ("worst", True)
    return pd.DataFrame(rows).sort_values(key, ascending=rising, kind="stable", ignore_index=True)
