"""Directions of model errors: what one unit of each error adds to the simulated outputs.

Errors of sensors and fixed parameters need no linearized model (`output_directions`). All others act on it
(`LinearizedRecord`): an input, a parameter that is none, an initial state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg.lapack import dtbtrs

from fmuid.array_types import Floats
from fmuid.estimation import LeastSquares, Result
from fmuid.identification.line_directions import is_estimated, line_errors
from fmuid.identification.linearized_record import LinearizedRecord, StateForcing, both_ends
from fmuid.identification.model_errors import CHANGING, SENSOR_ERRORS, Direction, ErrorKey, ErrorKind, Sizes
from fmuid.identification.output_directions import (
    SETTINGS,
    fixed_columns,
    only_in,
    rms_of,
    row_columns,
    sensor_columns,
    squares_by_unit,
)
from fmuid.simulation import AnySimulator, Simulator
from fmuid.units import parse_unit

SECANTS = (ErrorKind.DELAY, ErrorKind.ADVANCE, ErrorKind.LAG, ErrorKind.CLOCK)


def model_directions(
    problem: LeastSquares, simulators: Sequence[AnySimulator], result: Result, sizes: Sizes
) -> tuple[Direction, ...]:
    """Return the directions of model errors at a result; errors in time are not linear in their sizes."""
    local = result.fit.linearization
    assert local is not None, "a result from a file has no linearization"
    theta, simulated = result.values, result.fit.simulated
    levels = local.levels
    jacobian = -local.jacobian * levels[:, None]
    found: dict[ErrorKey, dict[int, Direction]] = {}
    slopes = [problem.tables(problem.unscaled(column)) for column in jacobian.T]
    for index, simulator in enumerate(simulators):
        columns = problem.parameters.for_experiment(index)[1]
        own = np.array([slopes[i][index] for i in columns])
        for each in _over(simulator, theta[columns], simulated[index], own, len(problem.experiments), sizes):
            found.setdefault(each.key, {})[index] = each
    empty = [np.zeros(each.output_values.shape) for each in problem.experiments]
    directions = []
    for (kind, subject), parts in found.items():
        tables = [parts[i].column if i in parts else zeros for i, zeros in enumerate(empty)]
        first = next(iter(parts.values()))
        usual = float(np.mean([each.usual for each in parts.values()]))
        column = problem.stacked(tables)
        if (
            kind in CHANGING and subject[0] in result.names
        ):  # by its value where the record sees it: no shift of its own
            i = result.names.index(subject[0])
            column = column - jacobian[:, i] * (local.root @ (local.root.T @ (jacobian.T @ (column / levels**2))))[i]
        is_free = kind is ErrorKind.INITIAL_STATE and _is_along(column / levels, jacobian / levels[:, None])
        if np.isfinite(column).all() and column.any() and not is_free:
            directions.append(replace(first, usual=usual, column=column))
    return tuple(directions)


def _over(
    simulator: AnySimulator, theta: Floats, simulated: Floats, slopes: Floats, experiments: int, sizes: Sizes
) -> Iterator[Direction]:
    """Yield the directions over one experiment that are no parameters."""
    found = (
        _columns(simulator, theta, simulated, slopes, experiments, sizes)
        if isinstance(simulator, Simulator)
        else row_columns(simulator, theta, simulated, slopes, sizes)
    )
    for each in found:
        if not is_estimated(each.kind, each.subject, simulator.parameters):
            yield each


def changes_by(
    sizes: Sizes, simulator: AnySimulator, theta: Floats, simulated: Floats, slopes: Floats
) -> dict[ErrorKey, Floats]:
    """Return what a unit of each error adds to outputs (K, n_y).

    Slopes (N, K, n_y) are by theta. Sensors read the machine with its own errors.
    """
    found, machine = dict[ErrorKey, Floats](), simulated
    for _ in range(1 if all(kind in SENSOR_ERRORS for kind, _ in sizes) else 2):
        every = _over(simulator, theta, machine, slopes, 1, sizes)
        found = {each.key: each.column for each in every if each.key in sizes}
        own = [sizes[key] * column for key, column in found.items() if key[0] not in SENSOR_ERRORS]
        machine = simulated + np.sum(own, axis=0) if own else simulated
    return found


def _is_along(column: Floats, others: Floats) -> bool:
    """Return True if one of others (n, N) is parallel."""
    sizes = np.linalg.norm(others, axis=0) * np.linalg.norm(column)
    return bool((np.abs(column @ others) > (1.0 - 0.5 * SETTINGS.alike**2) * sizes).any())


def _columns(
    simulator: Simulator, theta: Floats, simulated: Floats, slopes: Floats, experiments: int, sizes: Sizes
) -> Iterator[Direction]:
    """Yield the directions over one experiment."""
    experiment = simulator.experiment
    known, names = {**experiment.of_model.units, **experiment.units}, experiment.of_model.columns | experiment.columns
    units = {name: known.get(name) or simulator.system.unit(name) or "" for name in names}
    yield from sensor_columns(experiment, simulated, units)
    yield from fixed_columns(simulator, theta)
    record = LinearizedRecord.of(simulator.model_at(theta), theta)
    if record is None or not _agrees(simulator, theta, simulator.seen(record.sensitivities, theta), slopes):
        return
    yield from _of_slopes(record, simulator, theta, units, sizes)
    plain = simulator.observed is None
    forced = list(_of_inputs(record, simulated, units) if plain else _of_lines(record, simulator, simulated, units))
    forced += _of_parameters(record, simulator, units)
    forced += _of_initial_states(record, simulator, experiments)
    tables = simulator.seen(record.response([each[1] for each in forced]), theta)
    for (made, _), table in zip(forced, tables, strict=True):
        yield replace(made, column=table)


def _agrees(simulator: Simulator, theta: Floats, linearized: Floats, slopes: Floats) -> bool:
    """Return True if linearized and simulated sensitivities (N, K, n_y) agree.

    They are not where the model has events, delays or a memory. Slopes may be of other estimates, so they are taken
    again where they differ.
    """
    for i in np.arange(len(theta))[simulator.own].tolist():
        if _differs(linearized[i], slopes[i]):
            move = np.zeros(len(theta))
            move[i] = SETTINGS.fixed_step * max(abs(theta[i]), 1e-12)
            up, down = simulator(np.array([theta + move, theta - move]))
            if _differs(linearized[i], (up - down) / (2.0 * move[i])):
                return False
    return True


def _differs(own: Floats, other: Floats) -> bool:
    counted = np.isfinite(other)
    return bool(np.linalg.norm((own - other)[counted]) > SETTINGS.agreement * np.linalg.norm(other[counted]))


def _of_slopes(
    record: LinearizedRecord, simulator: Simulator, theta: Floats, units: Mapping[str, str], sizes: Sizes
) -> Iterator[Direction]:
    """Yield errors that follow the slopes of outputs: delays, lags, slow clocks (secants), hysteresis.

    In samples, of all outputs and of each.
    """
    middle, outputs, observed = record.half_samples, record.outputs, simulator.observed
    if observed is not None:
        (values,) = np.where(observed.map.is_delay, 0.0, observed.quantities(theta[None]))
        middle, outputs = observed.between(middle, values), observed.seen(outputs, values)
    elapsed = (record.times - record.times[0]) / np.ptp(record.times)
    names = simulator.experiment.output_names
    parts = [(names, slice(None))] + (
        [((name,), slice(j, j + 1)) for j, name in enumerate(names)] if len(names) > 1 else []
    )
    for kind in SECANTS:
        for subject, columns in parts:
            table = np.zeros(outputs.shape)
            size = sizes.get((kind, subject), math.nan)
            table[:, columns] = _secant(kind, outputs[:, columns], middle[:, columns], elapsed, size)
            yield Direction(kind, subject, "samples", SETTINGS.delay, kind is not ErrorKind.CLOCK, column=table)
    for j, (name, rises) in enumerate(zip(names, np.diff(outputs, axis=0, prepend=outputs[:1]).T, strict=True)):
        usual = SETTINGS.share * rms_of(outputs[:, j])
        if rises.any():
            against = only_in(outputs.shape, j, -signs(rises[:, None])[:, 0])
            yield Direction(ErrorKind.HYSTERESIS, (name,), units[name], usual, column=against)


def _secant(kind: ErrorKind, outputs: Floats, middle: Floats, elapsed: Floats, size: float) -> Floats:
    """Return the secant (K, m) of outputs by an error in time.

    Its size is in samples; NaN: the usual size.
    """
    usual, clock = SETTINGS.delay, kind is ErrorKind.CLOCK
    if not (size if not clock else abs(size)) > SETTINGS.least_delay * usual:
        if clock:
            moved = [_moved(outputs, middle, each * elapsed) for each in (usual, -usual)]
            return np.asarray((moved[0] - moved[1]) / (2.0 * usual))
        size = usual
    if kind is ErrorKind.LAG:
        return np.asarray((_lagging(outputs, middle, size) - outputs) / size)
    signed = -size if kind is ErrorKind.ADVANCE else size
    return np.asarray(
        (_moved(outputs, middle, signed * (elapsed if clock else np.ones_like(elapsed))) - outputs) / size
    )


def _moved(outputs: Floats, middle: Floats, samples: Floats) -> Floats:
    """Return outputs (K, m) late by samples (K,).

    Parabolas go through both samples and the middle between them.
    """
    places = np.clip(np.arange(len(outputs)) - samples, 0.0, len(outputs) - 1.0)
    first = np.minimum(places.astype(int), len(middle) - 1)
    x = (places - first)[:, None]
    begin, end = outputs[first], outputs[first + 1]
    return np.asarray(
        (1.0 - x) * (1.0 - 2.0 * x) * begin + 4.0 * x * (1.0 - x) * middle[first] + x * (2.0 * x - 1.0) * end
    )


def _lagging(outputs: Floats, middle: Floats, samples: float) -> Floats:
    """Return outputs (K, m) behind a first-order lag."""
    fine = np.zeros((2 * len(outputs) - 1, outputs.shape[1]))
    fine[::2], fine[1::2] = outputs - outputs[0], middle - outputs[0]
    pole = math.exp(-0.5 / samples)
    mean = 2.0 * samples * (1.0 - pole)
    driven = (1.0 - mean) * fine  # not by scipy.signal: slow to import
    driven[1:] += (mean - pole) * fine[:-1]
    banded = np.broadcast_to([[1.0], [-pole]], (2, len(fine)))
    return np.asarray(dtbtrs(banded, driven, uplo="L")[0][::2] + outputs[0])


def _input_change(record: LinearizedRecord, column: int, change: Floats) -> StateForcing:
    """Return the forcing of a change (P,) of an input."""
    direct = record.at_samples(record.outputs_by_input[column] * change[:, None])
    return StateForcing(record.by_input[column] * change[:, None], direct)


def _sum_of(parts: Sequence[StateForcing]) -> StateForcing:
    """Return the sum of changes of inputs."""
    rates, outputs = (np.sum([getattr(each, part) for each in parts], axis=0) for part in ("rates", "outputs"))
    return StateForcing(rates, outputs)


def _of_inputs(
    record: LinearizedRecord, simulated: Floats, units: Mapping[str, str]
) -> Iterator[tuple[Direction, StateForcing]]:
    """Yield errors of the inputs; interpolation also of all that are held, or are not."""
    experiment, alike = record.experiment, dict[bool, dict[str, StateForcing]]()
    for j, name in enumerate(experiment.input_names):
        values, ends = experiment.input_values[:, j], record.input_ends[:, j]
        if not values.any():
            continue
        usual, one = SETTINGS.share * rms_of(values), np.ones(len(ends))
        # what a sensor reads too much the model gets too much
        yield Direction(ErrorKind.INPUT_OFFSET, (name,), units[name], usual), _input_change(record, j, -one)
        yield Direction(ErrorKind.INPUT_GAIN, (name,), "", SETTINGS.share), _input_change(record, j, -ends)
        rise, between = np.diff(values), np.zeros(len(ends))
        if not rise.any():
            continue
        between[1::2] = rise if experiment.held[j] else -rise  # linear in place of held, or held in place of linear
        changed = _input_change(record, j, between)
        alike.setdefault(bool(experiment.held[j]), {})[name] = changed
        yield Direction(ErrorKind.INTERPOLATION, (name,), "", 1.0, True), changed
        if len(experiment.input_names) > 1:
            yield from _input_delays(record, j, rise)
    for parts in alike.values():
        if len(parts) > 1:
            yield Direction(ErrorKind.INTERPOLATION, tuple(parts), "", 1.0, True), _sum_of(list(parts.values()))
    yield from _dead_times(record, simulated, units)


def _of_lines(
    record: LinearizedRecord, simulator: Simulator, simulated: Floats, units: Mapping[str, str]
) -> Iterator[tuple[Direction, StateForcing]]:
    """Yield errors of line voltages, and of the inputs that are none."""
    observed = simulator.observed
    assert observed is not None, "an observation was asked for"
    experiment, voltages = record.experiment, set(observed.map.given.voltages)
    currents = observed.currents_behind(simulated, observed.quantities(record.theta[None])[0])
    if not np.isfinite(currents).all():
        currents = observed.currents(record.outputs)
    for made, forcing in _of_inputs(record, record.outputs, units):
        if made.kind is ErrorKind.INTERPOLATION or not voltages & set(made.subject):
            yield made, forcing
    places = [experiment.input_names.index(name) for name in observed.map.given.voltages]
    for made, change in line_errors(observed.map, currents):
        changes = both_ends(change)
        if observed.map.held:
            changes[1::2] = changes[::2]
        parts = [_input_change(record, j, changes[:, k]) for k, j in enumerate(places)]
        yield made, _sum_of(parts)


def _input_delays(record: LinearizedRecord, column: int, rise: Floats) -> Iterator[tuple[Direction, StateForcing]]:
    """Yield the delay of an input by a sample; of a held one it moves impulses."""
    subject = (record.experiment.input_names[column],)
    if not record.experiment.held[column]:
        change = -np.repeat(rise, 2)
        yield (
            Direction(ErrorKind.INPUT_DELAY, subject, "samples", SETTINGS.delay),
            _input_change(record, column, change),
        )
        return
    slope, h, none = record.by_input[column], np.diff(record.times)[:, None], np.zeros_like(record.rates)
    before, after = np.concatenate([[0.0], rise[:-1]]), rise
    begin, end = -h * slope[::2] * before[:, None], h * slope[1::2] * after[:, None]
    yield Direction(ErrorKind.INPUT_DELAY, subject, "samples", SETTINGS.delay, True), StateForcing(none, begin=begin)
    yield Direction(ErrorKind.INPUT_ADVANCE, subject, "samples", SETTINGS.delay, True), StateForcing(none, end=end)


def _dead_times(
    record: LinearizedRecord, simulated: Floats, units: Mapping[str, str]
) -> Iterator[tuple[Direction, StateForcing]]:
    """Yield dead times of inputs, alone and along their common vector; a refit has corrected the outputs."""
    experiment, ends = record.experiment, both_ends(simulated)
    pairs = {
        j: k
        for j, k in driven_outputs(record).items()
        if make_power(units[experiment.input_names[j]], units[experiment.output_names[k]])
    }
    for j, k in pairs.items():
        name, output = experiment.input_names[j], experiment.output_names[k]
        sign = -signs(ends[:, [k]])[:, 0]
        usual = SETTINGS.share * rms_of(experiment.input_values[:, j])
        yield Direction(ErrorKind.DEAD_TIME, (name, output), units[name], usual), _input_change(record, j, sign)
    for unit in dict.fromkeys(units[experiment.input_names[j]] for j in pairs):
        own = {j: k for j, k in pairs.items() if units[experiment.input_names[j]] == unit}
        if len(own) < 2 or len(set(own.values())) < len(own):
            continue
        along = -signs(ends[:, list(own.values())])
        parts = [_input_change(record, j, along[:, i]) for i, j in enumerate(own)]
        names = tuple(experiment.input_names[j] for j in own) + tuple(experiment.output_names[k] for k in own.values())
        usual = SETTINGS.share * rms_of(experiment.input_values[:, list(own)])
        yield Direction(ErrorKind.DEAD_TIME, names, unit, usual), _sum_of(parts)


def make_power(one: str, other: str) -> bool:
    """Return True if units make a power (angles aside) or are unknown."""
    found = [parse_unit(each) if each else None for each in (one, other, "W")]
    exponents = [each.exponents[:-1] for each in found if each is not None]
    return len(exponents) < 3 or tuple(map(sum, zip(*exponents[:2], strict=True))) == exponents[2]


def signs(signals: Floats) -> Floats:
    """Return smooth signs (P, 1), or directions of vectors (P, m)."""
    lengths = np.linalg.norm(signals, axis=1, keepdims=True)
    width = SETTINGS.sign_width * lengths.max()
    return np.asarray(np.tanh(signals / width) if signals.shape[1] == 1 else signals / np.maximum(lengths, width))


def driven_outputs(record: LinearizedRecord) -> dict[int, int]:
    """Return the output whose slope each input drives most, by C ∂ẋ/∂u; none without a slope or a change of sign."""
    found: dict[int, int] = {}
    sizes = np.sqrt(np.mean(record.ends**2, axis=0)) + 1e-300
    for j, slope in enumerate(record.by_input):
        direct = np.sqrt(np.mean(np.einsum("pij,pj->pi", record.observed, slope) ** 2, axis=0)) / sizes
        if direct.size and direct.max() > 0.0 and np.ptp(record.experiment.input_values[:, j]) > 0.0:
            found[j] = int(np.argmax(direct))
    changing = (record.ends.min(axis=0) < 0.0) & (record.ends.max(axis=0) > 0.0)
    return {j: k for j, k in found.items() if changing[k]}


def _of_parameters(
    record: LinearizedRecord, simulator: Simulator, units: Mapping[str, str]
) -> Iterator[tuple[Direction, StateForcing]]:
    """Yield parameters that depend on amplitudes, or change in time."""
    times = both_ends(record.times)
    ramp = (times - times.mean()) / np.ptp(times)
    halves = np.where(np.repeat(np.diff(record.times).cumsum(), 2) <= 0.5 * np.ptp(times), -0.5, 0.5)
    signals: list[tuple[ErrorKind, tuple[str, ...], float, Floats]] = [
        (ErrorKind.DRIFT, (), SETTINGS.drift, ramp),
        (ErrorKind.STEP, (), SETTINGS.drift, halves),
    ]
    experiment = record.experiment
    signals += [
        (ErrorKind.SATURATION, names, SETTINGS.saturation, square)
        for names, square in squares_by_unit(experiment.output_names, record.ends, units)
    ]
    hidden = [j for j, name in enumerate(record.states) if name not in experiment.output_names]
    states, kinds = (
        [record.states[j] for j in hidden],
        {name: simulator.system.unit(name) or "" for name in record.states},
    )
    signals += [
        (ErrorKind.STATE_DEPENDENCE, names, SETTINGS.saturation, square)
        for names, square in squares_by_unit(states, both_ends(record.trajectory[:, hidden]), kinds)
    ]
    for i, parameter in enumerate(simulator.parameters):
        size = record.theta[i]
        for kind, names, usual, signal in signals:
            rates = size * record.by_parameter[i] * signal[:, None]
            direct = record.at_samples(size * record.outputs_by_parameter[i] * signal[:, None])
            if rates.any() or direct.any():
                yield Direction(kind, (parameter, *names), "", usual), StateForcing(rates, direct)


def _of_initial_states(
    record: LinearizedRecord, simulator: Simulator, experiments: int
) -> Iterator[tuple[Direction, StateForcing]]:
    """Yield the initial value of each state, of each experiment."""
    for name, axis, values in zip(record.states, np.eye(len(record.states)), record.trajectory.T, strict=True):
        usual = SETTINGS.initial * max(float(np.ptp(values)), 1e-300)
        subject = (name,) if experiments == 1 else (name, simulator.experiment.name)
        made = Direction(ErrorKind.INITIAL_STATE, subject, simulator.system.unit(name) or "", usual)
        yield made, StateForcing(np.zeros_like(record.rates), initial=axis)
