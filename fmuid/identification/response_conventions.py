"""Conventions of readings: signs, the unit of phases, and voltages between lines.

What fits badly is fitted again with each other convention; the one with which it fits is named.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import DEGREE, Experiment, FrequencyExperiment, Response, SteadyExperiment, response_of
from fmuid.errors import FmuidError
from fmuid.estimation import Evaluator, LeastSquares, Marquardt, Result
from fmuid.identification.data_defects import DefectKind
from fmuid.models import System
from fmuid.simulation import fit_of

Changed = Callable[[Sequence[Experiment]], LeastSquares]
"""Problem with other experiments."""


@dataclass(frozen=True)
class ConventionSettings:
    """Limits of the comparison of conventions."""

    poor: float = 80.0  # fit, %, below which other conventions are tried ...
    poor_in_time: float = 50.0  # ... of records, whose noise may be as large
    against: float = -0.5  # correlation of a record with its simulation from the initial guess: the sign is wrong
    better: float = 0.2  # largest relative error with another convention, over that of now


@dataclass(frozen=True, eq=False)
class OtherConvention:
    """Another convention of a signal, response or supply, with its experiment."""

    kind: DefectKind
    subject: str
    experiment: Experiment


SETTINGS = ConventionSettings()
VOLTAGE = "voltage"  # subject of a supply


def find_conventions(
    system: System, experiments: Sequence[Experiment], result: Result, changed: Changed
) -> Iterator[tuple[str, str, str, float]]:
    """Yield readings that fit otherwise: convention, subject, experiment and fit, %."""

    def fit_by(number: int, other: OtherConvention) -> float:
        trial = changed([other.experiment if k == number else each for k, each in enumerate(experiments)])
        try:
            simulated = Marquardt().search(Evaluator(trial)).fit.simulated[number]
        except FmuidError:  # such as a model that fails there: no remedy
            return -math.inf
        return _least_fit(system, (other.experiment, simulated), other.subject)

    for number, experiment in enumerate(experiments):
        pair = experiment, result.fit.simulated[number]
        if experiment.kind == "time":
            poor = _least_fit(system, pair, "") < SETTINGS.poor_in_time
            groups = [_signs(experiment, _at_start(changed(experiments), number))] if poor else []
        else:
            groups = _conventions(experiment)
        for group in filter(None, groups):
            if (now := _least_fit(system, pair, group[0].subject)) < SETTINGS.poor:
                best, i = max((fit_by(number, other), -i) for i, other in enumerate(group))
                if 100.0 - best <= SETTINGS.better * (100.0 - now):
                    yield group[-i].kind.value, group[-i].subject, experiment.name, best


def _least_fit(system: System, pair: tuple[Experiment, Floats], subject: str) -> float:
    """Return the least fit of a response, or of all outputs, %."""
    fit = fit_of(system, *pair)
    own = [each for name, each in zip(fit.outputs, fit.fit, strict=True) if response_of(name) == subject != ""]
    return min(filter(math.isfinite, own or fit.fit), default=100.0)


def _at_start(problem: LeastSquares, number: int) -> Floats:
    """Return the outputs (K, n_y) of an experiment at the initial guesses; NaN if they cannot be simulated."""
    columns = problem.parameters.for_experiment(number)[1]
    return np.asarray(problem.predictors[number].many(problem.parameters.start[columns][None]).outputs[0])


def _signs(experiment: Experiment, simulated: Floats) -> list[OtherConvention]:
    """Return the other sign of outputs against the simulation.

    Of inputs where all are against it; each, and all together.
    """
    if experiment.observation is not None:
        return []
    pairs = zip(experiment.output_values.T, simulated.T, experiment.counted.T, strict=True)
    against = [bool(own.any()) and _are_opposite(measured[own], outputs[own]) for measured, outputs, own in pairs]
    names = [name for name, each in zip(experiment.output_names, against, strict=True) if each]
    alike = ""  # all outputs reversed look like all inputs reversed
    if all(against) and experiment.input_names:
        names, alike = list(experiment.input_names), f" or {', '.join(names)}"
    subjects = {name: [name] for name in names} if len(names) > 1 else {}
    subjects |= {", ".join(names) + alike: names} if names else {}
    return [OtherConvention(DefectKind.SIGN, each, _reversed(experiment, own)) for each, own in subjects.items()]


def _are_opposite(measured: Floats, simulated: Floats) -> bool:
    """Return True if the correlation of two signals is negative enough; constants and NaN have none."""
    off, back = measured - measured.mean(), simulated - simulated.mean()
    return float(off @ back) < SETTINGS.against * float(np.linalg.norm(off) * np.linalg.norm(back))


def _conventions(experiment: Experiment) -> list[list[OtherConvention]]:
    """Return the other conventions of each response, or of the supply."""
    if isinstance(experiment, FrequencyExperiment):
        return [list(_of_response(experiment, name)) for name in experiment.responses]
    if not isinstance(experiment, SteadyExperiment) or experiment.supply is None:
        return []
    own = experiment.supply
    kind = DefectKind.LINE_VOLTAGE if own.line_voltage is None else DefectKind.PHASE_VOLTAGE
    supply = replace(own, voltage=own.line_voltage, line_voltage=own.voltage)
    inputs = {name: column for name, column in experiment.columns.items() if name in experiment.input_names}
    inputs = {name: column for name, column in inputs.items() if name not in own.given}
    units = {name: unit for name, unit in experiment.units.items() if name not in own.given}
    return [[OtherConvention(kind, VOLTAGE, replace(experiment, supply=supply, inputs=inputs, units=units))]]


def _reversed(experiment: Experiment, names: Sequence[str]) -> Experiment:
    columns = dict.fromkeys(experiment.columns[name] for name in names)
    return replace(experiment, frame=experiment.frame.assign(**{each: -experiment.frame[each] for each in columns}))


def _of_response(experiment: FrequencyExperiment, name: str) -> Iterator[OtherConvention]:
    own = experiment.responses[name]

    def as_(kind: DefectKind, response: Response) -> OtherConvention:
        responses = {**experiment.responses, name: response}
        return OtherConvention(kind, name, replace(experiment, outputs=(), responses=responses))

    if {"imaginary", "phase"} & own.columns.keys():
        yield as_(DefectKind.CONJUGATE, replace(own, conjugate=not own.conjugate))
    if set(own.columns) - {"magnitude", "decibel"}:
        yield as_(DefectKind.SIGN, replace(own, of=own.reversed_ratio))
    if own.phase is not None:
        column = experiment.columns[f"{name}.phase"]
        radians = experiment.frame.assign(**{column: experiment.frame[column] / DEGREE})
        yield OtherConvention(DefectKind.RADIANS, name, replace(experiment, outputs=(), frame=radians))
