"""Directions of model errors without the linearized model: sensors, fixed parameters, and rows without a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import DECIBEL, DEGREE, Experiment, complex_values
from fmuid.identification.model_errors import Direction, ErrorKind, Sizes
from fmuid.simulation import AnySimulator, FrequencySimulator, output_unit


@dataclass(frozen=True)
class DirectionSettings:
    """Usual sizes of errors, and numbers of their directions."""

    delay: float = 0.5  # samples: where in an interval a channel is read
    least_delay: float = 0.1  # of it: smaller secants are differences of rounded outputs
    share: float = 0.01  # of an amplitude: gains, offsets, error voltages of ordinary sensors and inverters
    joint: float = 0.5  # of this share: a joint is some per mille of the impedance
    saturation: float = 0.1  # of a parameter at the largest amplitude
    drift: float = 0.05  # of a parameter over the record: 13 K of copper
    fixed: float = 0.1  # of a fixed parameter
    initial: float = 0.05  # of a state's range
    sign_width: float = 0.02  # of the amplitude: where the sign of a current changes
    most_fixed: int = 12  # fixed parameters; each costs a simulation
    fixed_step: float = 1e-3  # relative
    alike: float = 1e-3  # part of an initial state's column that a free start value leaves
    agreement: float = 0.1  # relative error of the linearized sensitivities that still allows these directions


SETTINGS = DirectionSettings()


def row_columns(
    simulator: AnySimulator, theta: Floats, simulated: Floats, slopes: Floats, sizes: Sizes
) -> Iterator[Direction]:
    """Yield the directions over an experiment without a time: sensors, fixed parameters and saturation.

    At rest, a parameter that depends on an output changes each row by the row's own slope.
    """
    experiment = simulator.experiment
    units = {name: output_unit(simulator.system, experiment, name) or "" for name in experiment.output_names}
    if isinstance(simulator, FrequencySimulator):
        yield from _of_responses(simulator, simulated, units, sizes)
        yield from fixed_columns(simulator, theta)
        return
    yield from sensor_columns(experiment, simulated, units)
    yield from fixed_columns(simulator, theta)
    for names, square in squares_by_unit(experiment.output_names, simulated, units):
        for name, value, slope in zip(simulator.parameters, theta, slopes, strict=True):
            table = value * np.nan_to_num(slope) * square[:, None]
            yield Direction(ErrorKind.SATURATION, (name, *names), "", SETTINGS.saturation, column=table)


def _of_responses(
    simulator: FrequencySimulator, simulated: Floats, units: Mapping[str, str], sizes: Sizes
) -> Iterator[Direction]:
    """Yield gain, delay and offset of each response, by its relative change; of a delay the secant of its size."""
    names, angular = simulator.output_names, simulator.angular
    for name, response in simulator.experiment.responses.items():
        columns = {part: names.index(f"{name}.{part}") for part in response.columns}
        values = complex_values({part: simulated[:, j] for part, j in columns.items()})
        one = np.ones(len(values), dtype=np.complex128)
        found = [(ErrorKind.GAIN, "", SETTINGS.share, one)]
        if len(columns) == 2:
            late = one * angular * (1j if response.conjugate else -1j)
            sample = np.pi / float(angular.max())  # the longest that resolves the highest frequency
            found.append((ErrorKind.RESPONSE_DELAY, "s", SETTINGS.delay * sample, late))
        if len(columns) == 2 and response.decibel is None:
            unit = units[f"{name}.{next(iter(columns))}"]
            found.append((ErrorKind.OFFSET, unit, SETTINGS.share * rms_of(np.abs(values)), one / values))
        for kind, unit, usual, change in found:
            size = sizes.get((kind, (name,)), 0.0) if kind is ErrorKind.RESPONSE_DELAY else 0.0
            moved = values * (np.expm1(change * size) / size if size else change)
            by_part = {"real": moved.real, "imaginary": moved.imag, "magnitude": np.abs(values) * change.real}
            by_part |= {"decibel": change.real / DECIBEL, "phase": change.imag / DEGREE}
            table = np.zeros(simulated.shape)
            for part, j in columns.items():
                table[:, j] = by_part[part]
            yield Direction(kind, (name,), unit, usual, column=table)


def sensor_columns(experiment: Experiment, simulated: Floats, units: Mapping[str, str]) -> Iterator[Direction]:
    """Yield offset, its drift, gain, and gain by amplitude, of each output."""
    elapsed = experiment.times - experiment.times[0]
    timed = experiment.kind == "time" and elapsed[-1] > 0.0
    for j, name in enumerate(experiment.output_names):
        usual, shape, own = SETTINGS.share * rms_of(simulated[:, j]), simulated.shape, simulated[:, j]
        yield Direction(ErrorKind.OFFSET, (name,), units[name], usual, column=only_in(shape, j, 1.0))
        if timed:
            drift = only_in(shape, j, elapsed / elapsed[-1])
            yield Direction(ErrorKind.ZERO_DRIFT, (name,), units[name], usual, column=drift)
        yield Direction(ErrorKind.GAIN, (name,), "", SETTINGS.share, column=only_in(shape, j, own))
        cubic = -own * (own / max(float(np.abs(own).max()), 1e-300)) ** 2
        yield Direction(ErrorKind.NONLINEARITY, (name,), "", SETTINGS.share, column=only_in(shape, j, cubic))


def fixed_columns(simulator: AnySimulator, theta: Floats) -> Iterator[Direction]:
    """Yield other values of the fixed parameters, in shares of them: one simulation each."""
    fixed = fixed_parameters(simulator)
    names = list(fixed)[: SETTINGS.most_fixed]
    if not names:
        return
    values = np.array([fixed[name] for name in names])
    experiment, held = simulator.experiment, simulator.experiment.values
    if not held.keys().isdisjoint(names):
        experiment = replace(experiment, values={name: held[name] for name in held if name not in names})
    other = simulator.over(experiment, (*simulator.parameters, *names))
    base = np.concatenate([theta, values])
    moved = np.tile(base, (len(names), 1))
    moved[np.arange(len(names)), len(theta) + np.arange(len(names))] *= 1.0 + SETTINGS.fixed_step
    found = other.many(np.vstack([base, moved]))
    for name, value, error, outputs in zip(names, values.tolist(), found.errors[1:], found.outputs[1:], strict=True):
        if error is None and found.errors[0] is None:
            table = (outputs - found.outputs[0]) / SETTINGS.fixed_step
            if table.any():
                yield Direction(ErrorKind.FIXED, (name,), "", SETTINGS.fixed, value=value, column=table)


def fixed_parameters(simulator: AnySimulator) -> dict[str, float]:
    """Return fixed real parameters that are not zero, the study's first."""
    system, values = simulator.system, {**simulator.system.values, **simulator.settings[0]}
    mine = set(simulator.target_names)
    found = {
        name: float(value) for name, value in values.items() if isinstance(value, float | int) and name not in mine
    }
    for name, variable in system.variables.items():
        if variable.causality == "parameter" and isinstance(variable.start, float | int) and name not in mine:
            found.setdefault(name, float(variable.start))
    return {
        name: value
        for name, value in found.items()
        if value
        and system.variables[name].type == "Real"
        and not system.variables[name].array
        and system.variables[name].settable
    }


def squares_by_unit(
    names: Sequence[str], values: Floats, units: Mapping[str, str]
) -> Iterator[tuple[tuple[str, ...], Floats]]:
    """Yield signals of one unit together: names, and squares (P,) relative to the largest."""
    for unit in dict.fromkeys(units[name] for name in names):
        own = [j for j, name in enumerate(names) if units[name] == unit]
        square = np.sum(values[:, own] ** 2, axis=1)
        if square.any():
            yield tuple(names[j] for j in own), square / square.max()


def rms_of(values: Floats) -> float:
    """Return the root mean square, above 0."""
    return max(float(np.sqrt(np.mean(values**2))), 1e-300)


def only_in(shape: tuple[int, ...], column: int, values: Floats | float) -> Floats:
    """Return a table with values in one column, else 0."""
    found = np.zeros(shape)
    found[:, column] = values
    return found
